"""Cameras in the world and the unit of another program, placed as a rig: in mm, around the origin, with its axes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.rig.camera_arrays import nearest_point
from pipeline.rig.cameras import FORMAT, RigCalibration
from pipeline.rig.document import decompose_projection, rig_from_document

Entry = dict[str, Any]
"""A camera as an entry of the rig document, but for its lengths: `R` and `t_mm` in the world and units of the file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """Unit and origin of the world of a file."""

    mm_per_unit: float = 1.0
    origin: tuple[float, float, float] | None = (0.0, 0.0, 0.0)
    """In the file's units; None: the point nearest to all optical axes."""

    def __str__(self) -> str:
        origin = "nearest to the axes" if self.origin is None else "{:g},{:g},{:g}".format(*self.origin)
        return f"{self.mm_per_unit:g} mm a unit, origin {origin}"


def placed_rig(name: str, entries: Sequence[Entry], placement: Placement) -> RigCalibration:
    """Return the rig of cameras in the order of their ids, in mm, around the origin.

    Raises
    ------
    RigError
        As `rig_from_document`.
    """
    entries = sorted(entries, key=lambda entry: str(entry["id"]))
    for index, entry in enumerate(entries):
        if "projection" in entry:
            projection = np.asarray(entry.pop("projection"), np.float64)
            entry["K"], entry["R"], entry["t_mm"] = decompose_projection(projection, f"cameras[{index}]")
    rotations = np.array([entry["R"] for entry in entries]).reshape(-1, 3, 3)
    shifts = np.array([entry["t_mm"] for entry in entries]).reshape(-1, 3)
    origin = np.asarray(placement.origin or np.zeros(3))
    if placement.origin is None and len(entries) > 1:
        origin = nearest_point(-(shifts[:, None] @ rotations)[:, 0], rotations[:, 2])
    placed_mm = placement.mm_per_unit * (rotations @ origin + shifts)
    cameras = [
        {**entry, "K": np.asarray(entry["K"]).tolist(), "R": R.tolist(), "t_mm": t_mm.tolist()}
        for entry, R, t_mm in zip(entries, rotations, placed_mm, strict=True)
    ]
    return rig_from_document({"format": FORMAT, "name": name, "method": "imported", "cameras": cameras})
