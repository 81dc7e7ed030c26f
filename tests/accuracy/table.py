"""How far the measured hull lies from the body, beside the best that sixteen silhouettes allow.

Bodies in random poses are photographed by the synthetic rig, measured with the true rig, and compared
with their ideal surface: the sub-voxel field (the default), the paper's field, and the *floor*, the
exact visual hull of the same body in the same pose, computed from its exact silhouettes without any
image or voxel (support/hull_floor.py).

Run: .venv/bin/python tests/accuracy/table.py [--poses 10] [--seed 1]
"""

import argparse
import multiprocessing
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import mean

import cv2
import numpy as np
import trimesh
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parents[1]))
from support import rendered
from support.hull_floor import exact_hull_mesh, surface_distance

from pipeline.carving import CarvingParameters, carve
from pipeline.meshing import mesh_hull
from pipeline.particle import PipelineParameters, measure_bundle
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.bodies import Body, cube, cylinder, sphere
from pipeline.synthesis.bundles import render_bundle, stream
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.stones import STONE_FORMS, stone

SAMPLES = 20_000
"""Area-uniform points of a measured surface whose distances are averaged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One body in one pose; distances in mm, positive outside of the body."""

    body: str
    hull_mm: float  # mean absolute distance of the sub-voxel hull
    hull_max_mm: float
    hull_signed_mm: float
    paper_mm: float  # of the paper's field on the same silhouettes
    floor_mm: float  # of the exact hull
    volume_raw_percent: float  # error of the hull's volume
    volume_percent: float  # after the correction
    diameter_mm: float  # error of the equivalent diameter


def compare(name: str, number: int, seed: int) -> Comparison:
    """Photograph and measure one body in a pose that `number` and `seed` decide."""
    rng = stream(seed, 100 + sorted(BODIES).index(name), number)
    body, rig = body_named(name, number, rng), rendered.rig()
    placed = tumble(body, rig, rng)
    bundle = render_bundle([placed], rendered.simulated(), rng, sequence=100, label=name)
    result = measure_bundle(bundle, rig, rendered.background(), BackgroundSegmenter(), PipelineParameters())
    if result.rejection is not None or result.mesh is None or result.measurement is None:
        raise AssertionError(f"{name} {number} was rejected: {result.rejection}")
    truth, measurement = placed.world_mesh, result.measurement
    hull = trimesh.Trimesh(result.mesh.vertices_mm, result.mesh.faces, process=False)
    paper = mesh_hull(carve(result.silhouettes, rig, replace(CarvingParameters(), field="view_count")))
    if paper is None:
        raise AssertionError(f"{name} {number}: the paper's field is empty")
    paper_hull = trimesh.Trimesh(paper.vertices_mm, paper.faces, process=False)
    floor = exact_hull_mesh(truth, truth.center_mass, rig)
    mean_mm, max_mm, signed_mm = surface_distance(hull, truth, SAMPLES, rng)
    true_diameter_mm = np.cbrt(6 * truth.volume / np.pi)
    return Comparison(
        body=name,
        hull_mm=mean_mm,
        hull_max_mm=max_mm,
        hull_signed_mm=signed_mm,
        paper_mm=surface_distance(paper_hull, truth, SAMPLES, rng)[0],
        floor_mm=surface_distance(floor, truth, SAMPLES, rng)[0],
        volume_raw_percent=100 * (measurement.shape.volume_mm3 / truth.volume - 1),
        volume_percent=100 * (measurement.volume_mm3 / truth.volume - 1),
        diameter_mm=float(measurement.equivalent_diameter_mm - true_diameter_mm),
    )


BODIES = ("sphere", "cylinder", "cube", "stones")


def body_named(name: str, number: int, rng: np.random.Generator) -> Body:
    """The body of a row; stones of 10 to 36 mm go through the five classes."""
    match name:
        case "sphere":
            return sphere()
        case "cylinder":
            return cylinder()
        case "cube":
            return cube()
    forms = sorted(STONE_FORMS)
    return stone(forms[number % len(forms)], float(rng.uniform(10, 36)), rng)


def compare_all(poses: int, seed: int) -> dict[str, list[Comparison]]:
    """All bodies, in as many processes as there are cores."""
    jobs = [(name, number, seed) for name in BODIES for number in range(poses)]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count(), mp_context=context, initializer=_one_thread) as pool:
        compared = list(pool.map(compare, *zip(*jobs, strict=True)))
    return {name: [row for row in compared if row.body == name] for name in BODIES}


def _one_thread() -> None:
    cv2.setNumThreads(1)
    threadpool_limits(1)


def table_of(compared: dict[str, list[Comparison]], seed: int) -> Table:
    """Averages over the poses, lengths in mm."""
    table = Table(
        "body", "n", "hull mean", "max", "signed", "floor mean", "over floor", "paper's field",
        "raw volume %", "volume %", "d_V error",
        title=f"distance to the true surface, mm; averages over random poses, seed {seed}",
    )  # fmt: skip
    for name, rows in compared.items():
        table.add_row(name, str(len(rows)), *cells(rows))
    return table


def cells(rows: Sequence[Comparison]) -> Iterator[str]:
    for attribute in ("hull_mm", "hull_max_mm", "hull_signed_mm", "floor_mm"):
        yield f"{mean(getattr(row, attribute) for row in rows):.4f}"
    yield f"{mean(row.hull_mm - row.floor_mm for row in rows):+.4f}"
    yield f"{mean(row.paper_mm for row in rows):.4f}"
    yield f"{mean(row.volume_raw_percent for row in rows):+.2f}"
    yield f"{mean(row.volume_percent for row in rows):+.2f}"
    yield f"{mean(row.diameter_mm for row in rows):+.4f}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    Console(width=150).print(table_of(compare_all(arguments.poses, arguments.seed), arguments.seed))
