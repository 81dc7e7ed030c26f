"""What our own convex hulls save of a stone's processing time, beside scipy's of the same points.

Run: .venv/bin/python tests/benchmarks/convex_hulls.py [--size-mm 25] [--stones 4] [--seed 1] [--repeat 15]

CPU milliseconds on one thread, the least of the repeats, medians of the stones; the whole is `measure_bundle`, frames
to all measures. An own hull stays where it saves more than `WORTH_PERCENT` of that; exits with 1 where it does not.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from research.performance import measured, worker_context
from support.printed import show

from pipeline.arrays import Directions, PointsMM, Vector
from pipeline.estimate import inner
from pipeline.estimate.tangents import Tangents, find_tangents
from pipeline.evaluation.scene import BODY, EvaluationScene, build_scene
from pipeline.frames import FrameBundle
from pipeline.geometry import quickhull
from pipeline.geometry.growing_hull import facets_of, growth_for
from pipeline.particle import ParticleResult
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.stones import stone
from pipeline.views.prepared import prepare_views
from service.processing.compiled_code import isolate_numba_cache
from service.processing.measure_job import initialize

FORM = "angular"
WORTH_PERCENT = 5.0
UNSEEN = -9
"""Mark of points that wait above no facet."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stone:
    """One photographed stone and what its hulls are made of."""

    bundle: FrameBundle
    tangents: Tangents
    mesh_mm: PointsMM  # vertices of the measured body


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One kind of hull."""

    what: str
    peer: str
    times_ms: Sequence[tuple[float, float]]  # of each stone: ours, the library's

    def saved_percent(self, whole_ms: float) -> float:
        """Return what ours saves of the time of a whole stone."""
        return 100 * median(theirs_ms - ours_ms for ours_ms, theirs_ms in self.times_ms) / whole_ms


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size-mm", type=float, default=25)
    parser.add_argument("--stones", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeat", type=int, default=15)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    isolate_numba_cache()
    initialize(worker_context())
    scene = build_scene(arguments.seed)
    stones = [photographed(scene, arguments, number) for number in range(arguments.stones)]
    whole_ms = median(
        least_ms(partial(measured, each.bundle, scene, "estimate"), arguments.repeat) for each in stones
    )
    rows = compared(stones, arguments.repeat)
    title = (
        f"stones of {arguments.size_mm:g} mm, {whole_ms:.1f} ms each; load {os.getloadavg()[0]:.1f}"
        f" on {os.cpu_count()} cores"
    )
    show(table_of(rows, whole_ms, title), as_json=arguments.json, width=120)
    dispensable = [row for row in rows if row.saved_percent(whole_ms) < WORTH_PERCENT]
    for row in dispensable:
        Console(stderr=True).print(f"FAILED: {row.peer} does as well as ours for the {row.what}")
    return int(bool(dispensable))


def photographed(scene: EvaluationScene, arguments: argparse.Namespace, number: int) -> Stone:
    """Render, segment and measure a stone of the seed."""
    rng = stream(arguments.seed, BODY, number)
    body = tumble(stone(FORM, arguments.size_mm, rng), scene.true_rig, rng)
    bundle = scene.photograph(body, rng, FORM)
    result: ParticleResult = measured(bundle, scene, "estimate")[1]
    assert result.mesh is not None
    views = prepare_views(result.silhouettes, scene.true_rig).without(list(result.dropped))
    vertices_mm = result.mesh.vertices_mm
    center_mm: Vector = (vertices_mm.min(axis=0) + vertices_mm.max(axis=0)) / 2
    return Stone(bundle=bundle, tangents=find_tangents(views, center_mm), mesh_mm=vertices_mm)


def least_ms(work: Callable[[], object], repeat: int) -> float:
    """Return the least CPU time of `repeat` runs, after one that does not count."""
    work()
    times_s = []
    for _ in range(repeat):
        start_s = time.process_time()
        work()
        times_s.append(time.process_time() - start_s)
    return 1000 * min(times_s)


def compared(stones: list[Stone], repeat: int) -> list[Row]:
    """Time both ways of every kind of hull on all stones."""
    mesh = [
        (
            least_ms(partial(quickhull.hull_facets, each.mesh_mm), repeat),
            least_ms(partial(facets_by_qhull, each.mesh_mm), repeat),
        )
        for each in stones
    ]
    own_ms = [least_ms(partial(inner.inner_body, each.tangents), repeat) for each in stones]
    with inner_bodies_by_qhull():
        qhull_ms = [least_ms(partial(inner.inner_body, each.tangents), repeat) for each in stones]
    return [
        Row(what="vertices of the mesh", peer="own prefilter and scipy", times_ms=mesh),
        Row(
            what="touching points of the inner body",
            peer="scipy, anew for each of 5 batches",
            times_ms=list(zip(own_ms, qhull_ms, strict=True)),
        ),
    ]


def facets_by_qhull(points_mm: PointsMM) -> tuple[np.ndarray, Directions]:
    """Return what `hull_facets` does, with qhull in place of the growing hull behind the same prefilter."""
    points = np.ascontiguousarray(points_mm)
    protruding = np.arange(len(points), dtype=np.int32)[:: quickhull.RUN].copy()
    quickhull._find_protruding(points, points.take(protruding, axis=0).mean(axis=0), protruding)
    outer = points.take(protruding, axis=0)
    growth = growth_for(len(points), float(np.ptp(outer, axis=0).max()), quickhull.TOLERANCE)
    quickhull.restart_by_qhull(points, protruding, growth)
    growth.following.fill(UNSEEN)
    walls = np.empty((growth.counts[0], 3, 3))
    assert quickhull._locate(points, outer.mean(axis=0), walls, growth)
    outside = np.flatnonzero(growth.following != UNSEEN).astype(np.int32)
    corners = np.unique(growth.facets[: growth.counts[0], :3])
    quickhull.restart_by_qhull(points, np.concatenate([corners, outside]), growth)
    facets = facets_of(growth)
    return facets.corners, facets.planes[:, :3].copy()


@contextmanager
def inner_bodies_by_qhull() -> Iterator[None]:
    """Have qhull make every batch's hull of all points so far."""
    kept = inner.start, inner.grow
    inner.start, inner.grow = (lambda points, which, growth: True), (lambda points, growth: False)
    try:
        yield
    finally:
        inner.start, inner.grow = kept


def table_of(rows: list[Row], whole_ms: float, title: str) -> Table:
    table = Table("convex hull of", "library", title=title)
    for heading in ("ours ms", "its ms", "ours saves of a stone"):
        table.add_column(heading, justify="right")
    for row in rows:
        ours_ms, theirs_ms = (median(times_ms) for times_ms in zip(*row.times_ms, strict=True))
        table.add_row(
            row.what,
            row.peer,
            f"{ours_ms:.2f}",
            f"{theirs_ms:.2f}",
            f"{row.saved_percent(whole_ms):.1f} %",
        )
    return table


if __name__ == "__main__":
    sys.exit(main())
