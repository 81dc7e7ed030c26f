"""Tables of times that `stonefall benchmark` prints."""

import os
from collections.abc import Sequence

from rich.table import Table

from service.commands.benchmarks.performance import N_RUNS, SizeTimes
from service.commands.benchmarks.scaling import N_BUNDLES, Scaling


def performance_tables(times: Sequence[SizeTimes], seed: int) -> list[Table]:
    """Return the times of all stages, and those of the three kinds of body, with a row for each size of stones."""
    stages = Table(
        title=f"ms of processor time a stone on one thread, quickest of {N_RUNS} runs, medians of {times[0].n} stones a"
        f" size, seed {seed}; {_machine()}",
        caption="all: frames to all measures of the estimated body; silhouettes to mesh: the hull, with integrals;"
        " GFLOP/s: of the processor meanwhile (product of matrices), 97 to 100 where the goals were found",
    )
    for heading in ("stone mm", *times[0].stages_ms, "all", "p95", "silhouettes to mesh", "GFLOP/s"):
        stages.add_column(heading, justify="right")
    bodies = Table(
        title="the same with each kind of body",
        caption="file to result: a bundle on disk to its durable result with the refined and textured body, photo",
    )
    for heading in (
        "stone mm", "hull", "estimate", "photo", "refinement", "texture", "file to result", "by the clock", "p95",
    ):  # fmt: skip
        bodies.add_column(heading, justify="right")
    for row in times:
        figures = (*row.stages_ms.values(), row.cpu_ms, row.cpu_p95_ms, row.mesh_ms, row.gflops)
        stages.add_row(f"{row.size_mm:g}", *(f"{figure:.1f}" for figure in figures))
        figures = (
            row.hull_ms, row.cpu_ms, row.photo_ms, row.refine_ms, row.texture_ms, row.way_cpu_ms, row.way_ms,
            row.way_p95_ms,
        )  # fmt: skip
        bodies.add_row(f"{row.size_mm:g}", *(f"{figure:.1f}" for figure in figures))
    return [stages, bodies]


def scaling_tables(scaling: Scaling, seed: int) -> list[Table]:
    """Return the tables by voxels, by views and by workers."""
    stone = f"a stone of {scaling.size_mm:g} mm, seed {seed}; {_machine()}"
    grids = Table(title=f"ms of processor time from silhouettes to mesh, {stone}")
    for heading in ("voxels", "faces", *scaling.grids[0].stages_ms):
        grids.add_column(heading, justify="right")
    for grid in scaling.grids:
        grids.add_row(f"{grid.n}^3", str(grid.n_faces), *(f"{ms:.1f}" for ms in grid.stages_ms.values()))
    grids.add_section()
    grids.add_row("grows as n^", "", *(f"{exponent:.2f}" for exponent in scaling.exponents().values()))

    views = Table(title=f"ms of processor time from frames to all measures, {stone}")
    for heading in ("views", *scaling.views[0].stages_ms, "all", "a view"):
        views.add_column(heading, justify="right")
    for row in scaling.views:
        figures_ms = (*row.stages_ms.values(), row.total_ms, row.total_ms / row.n_views)
        views.add_row(str(row.n_views), *(f"{ms:.1f}" for ms in figures_ms))

    workers = Table(title=f"{N_BUNDLES} times {stone}")
    for heading in ("workers", "stones/s by the clock", "ms of processor time a stone"):
        workers.add_column(heading, justify="right")
    for each in scaling.workers:
        workers.add_row(str(each.n_workers), f"{each.stones_per_s:.1f}", f"{each.cpu_ms:.0f}")
    return [grids, views, workers]


def _machine() -> str:
    return f"{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}"
