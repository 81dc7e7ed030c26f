"""Ground truth of a rendered body: the reference that a measurement is judged by."""

from dataclasses import asdict, dataclass
from typing import Any

import trimesh

from pipeline.frames import FrameBundle
from pipeline.measuring.shape import ShapeMeasurement
from pipeline.synthesis.renderer import PlacedBody


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TruthRecord:
    """The body of one bundle at the middle of its exposure."""

    bundle: str
    sequence: int
    placed: PlacedBody
    mesh: trimesh.Trimesh  # world frame, mm
    shape: ShapeMeasurement  # of the body, in its own frame


def truth_of(placed: PlacedBody, bundle: FrameBundle, shape: ShapeMeasurement) -> TruthRecord:
    """Return the truth about the body in a bundle; `shape` is that of `placed.body.mesh`."""
    return TruthRecord(
        bundle=bundle.name,
        sequence=bundle.trigger.sequence,
        placed=placed,
        mesh=placed.world_mesh,
        shape=shape,
    )


def truth_to_document(truth: TruthRecord) -> dict[str, Any]:
    """Return a line of `truth.jsonl`: what the result record measures, under the same names, its look and pose.

    `x_world = R @ x_body + center_mm`; `extents_mm` are the body's along its own axes.
    """
    body = truth.placed.body
    return {
        "bundle": truth.bundle,
        "sequence": truth.sequence,
        "kind": body.kind.value,
        "body": body.name,
        "surface": body.surface.value,
        "gloss": body.gloss,
        "interreflection": body.is_interreflecting,
        **asdict(truth.shape),
        "center_mm": truth.placed.offset_mm.tolist(),
        "extents_mm": body.mesh.extents.tolist(),
        "R": truth.placed.R.tolist(),
        "mesh": f"truth/{truth.bundle}.ply",
    }
