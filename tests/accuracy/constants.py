"""What each constant of the refinement is worth: errors on real rock with it halved and doubled, beside as it is.

A constant that neither changes is one too many; where both cost little, the optimum is flat, and its value needs no
better reason. Whoever changes one chooses by odd seeds, which no table is shown with.

Run: .venv/bin/python tests/accuracy/constants.py [--seeds 1] [--objects "basalt 18;cube"] [--only MIDDLE]
"""

import argparse
import os
import sys
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from rich.table import Table
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.printed import show
from support.rock_tables import FAR_MM
from support.rocks import CASES, photographed, scene_before

from pipeline.evaluation.surface_distances import Surface, even_samples
from pipeline.particle import BodyParameters, PipelineParameters, measure_bundle
from pipeline.refinement import grey_alignment, node_field, passes, patch_scores, refine, search
from pipeline.segmentation import segment_all
from pipeline.segmentation.subtraction import SegmentationParameters
from pipeline.synthesis.bundles import stream
from service.processing.models.networks import read_model
from service.processing.segmenters import SegmenterPlan, build_segmenter

OBJECTS = "granite wet;basalt 18;conglomerate;halves;cube"
PASSES = dict(
    zip(("COARSE", "MIDDLE", "FINE", "AGAIN"), (*passes.PASSES, passes.SEARCHED_AGAIN), strict=True)
)
ALONE = ("OUTWARD_MM", "DEEPEST_SHARE", "STIFFNESS", "SPIKE_SLOPE", "FULL_SIZE_MM", "UNLIKE", "ALIKE_SHARE",
         "UNLIKE_SHARE", "PEAKED", "EVIDENCE", "DOUBTFUL", "OLDER", "SURE", "PIN", "TOUCH_MM")  # fmt: skip
IN_ALIGNMENT = ("SPACING_MM", "SPREAD", "MOST_MM", "BLUR_PX", "MOST_BELOW_MM", "FULL_EVIDENCE")
VALUES: Mapping[str, float] = {name: getattr(passes, name) for name in ALONE} | {
    name: getattr(grey_alignment, name) for name in IN_ALIGNMENT
}
MODULES = (grey_alignment, node_field, passes, patch_scores, refine, search)
N_SAMPLES = 4_000


@dataclass(frozen=True, slots=True)
class Change:
    """A constant times a factor; 1 leaves all as it is."""

    of: str  # a pass, or empty
    name: str
    factor: float


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors of a refined body."""

    mean_mm: float
    far_percent: float
    volume_percent: float


def changes(only: str) -> Iterator[Change]:
    """Yield all changes whose name has `only` in it, the one that leaves all as it is first."""
    yield Change("", "", 1.0)
    constants = [(of, field.name) for of in PASSES for field in fields(passes.Pass) if field.name != "scale"]
    for of, name in [*constants, *(("", name) for name in VALUES)]:
        value = getattr(PASSES[of], name) if of else VALUES[name]
        if only in f"{of} {name}" and 0 < value < np.inf:
            yield from (Change(of, name, factor) for factor in (0.5, 2.0))


def apply(change: Change) -> None:
    """Set all constants as they are but the one that is changed, wherever they were imported."""
    changed = dict(PASSES)
    if change.of:
        each = PASSES[change.of]
        changed[change.of] = replace(each, **{change.name: change.factor * getattr(each, change.name)})
    values: dict[str, Any] = {
        name: value * (change.factor if (change.of, change.name) == ("", name) else 1.0)
        for name, value in VALUES.items()
    }
    values["PASSES"] = (changed["COARSE"], changed["MIDDLE"], changed["FINE"])
    values["SEARCHED_AGAIN"] = changed["AGAIN"]
    for module in MODULES:
        for name in values.keys() & vars(module).keys():
            setattr(module, name, values[name])


def errors_of(case: tuple[str, int], all_changes: list[Change]) -> list[Errors]:
    """Measure one object with each change, all by the same silhouettes and the true rig."""
    cv2.setNumThreads(1)
    name, seed = case
    with threadpool_limits(1):
        scene, seen = scene_before(CASES[name].wall, seed), photographed(name, seed)
        segmenter = build_segmenter(
            SegmenterPlan(wanted="auto", model=read_model()), SegmentationParameters()
        )
        silhouettes = segment_all(seen.bundle.frames, scene.background, segmenter)
        truth = Surface(seen.placed.world_mesh)
        parameters = PipelineParameters(body=BodyParameters("photo", texture=False))
        found = []
        for change in all_changes:
            apply(change)
            result = measure_bundle(
                seen.bundle,
                scene.true_rig,
                scene.background,
                lambda frame, _: silhouettes[frame.camera],
                parameters,
            )
            assert result.mesh is not None and result.measurement is not None, result.rejection
            mesh = trimesh.Trimesh(result.mesh.vertices_mm, result.mesh.faces, process=False)
            rng = stream(seed)
            far_mm = np.abs(
                np.concatenate(
                    [
                        truth.signed_distances_mm(even_samples(mesh, N_SAMPLES, rng)),
                        Surface(mesh).signed_distances_mm(even_samples(truth.mesh, N_SAMPLES, rng)),
                    ]
                )
            )
            volume_percent = 100 * (result.measurement.volume_mm3 / truth.mesh.volume - 1)
            found.append(
                Errors(float(far_mm.mean()), 100 * float((far_mm > FAR_MM).mean()), abs(volume_percent))
            )
    return found


def main() -> None:
    """Print what halving and doubling of each constant changes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", default="1", help="odd ones")
    parser.add_argument("--objects", default=OBJECTS, help="separated by semicolons")
    parser.add_argument(
        "--only", default="", help="part of the names of constants, such as MIDDLE or spacing"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    cases = [
        (name, int(seed)) for seed in arguments.seeds.split(",") for name in arguments.objects.split(";")
    ]
    all_changes = list(changes(arguments.only))
    with ProcessPoolExecutor(arguments.jobs, mp_context=get_context("forkserver")) as pool:
        by_case = list(pool.map(partial(errors_of, all_changes=all_changes), cases))
    means = {
        change: [
            float(np.mean([getattr(found[i], field.name) for found in by_case])) for field in fields(Errors)
        ]
        for i, change in enumerate(all_changes)
    }
    as_is = means[all_changes[0]]
    table = Table(
        "constant", "value", "halved: mean mm, far %, volume %", "doubled: mean mm, far %, volume %"
    )
    table.title = f"as it is: mean {as_is[0]:.4f} mm, far {as_is[1]:.2f} %, volume {as_is[2]:.2f} %"
    for half, twice in zip(all_changes[1::2], all_changes[2::2], strict=True):
        value = getattr(PASSES[half.of], half.name) if half.of else VALUES[half.name]
        differences = (
            " ".join(
                f"{new - old:+.{digits}f}"
                for new, old, digits in zip(means[of], as_is, (4, 2, 2), strict=True)
            )
            for of in (half, twice)
        )
        table.add_row(f"{half.of} {half.name}".strip(), f"{value:g}", *differences)
    show(table, as_json=arguments.json)


if __name__ == "__main__":
    main()
