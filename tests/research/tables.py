"""Tables and lines that `stonefall benchmark` prints: distances, errors, calibrations, the paper beside ours, times."""

import os
from collections.abc import Sequence

from rich.table import Table

from pipeline.evaluation.scene import rig_error
from pipeline.evaluation.summaries import (
    PUBLISHED_MM,
    AccuracySummary,
    Compared,
    compare_with_paper,
    summaries_of,
    summarize,
)
from pipeline.evaluation.trials import ISOLEVELS, STANDARDS
from pipeline.rig.design import as_built, nominal_rig
from pipeline.synthesis.stones import STONE_FORMS
from research.accuracy import CALIBRATIONS, BenchPlan, BenchResult
from research.paper import PUBLISHED_S, stage_seconds
from research.performance import N_RUNS, SizeTimes
from research.scaling import N_BUNDLES, Scaling

HEAD = ("body", "rig", "method", "n")


def accuracy_table(plan: BenchPlan, result: BenchResult) -> Table:
    """Return the averages by body, with the paper's published figures first where there are some."""
    table = _table(
        f"distance to the true surface, mm, and errors of volume and area; averages over random poses or bodies,"
        f" lens {plan.lens}, seed {plan.seed}",
        HEAD,
        ("mean", "max", "signed", "back mean", "back max", "mesh %", "volume %", "rms %", "area %"),
        caption="max: mean of the greatest distances; back: true surface to measured one; volume: as reported, "
        "mesh: of the mesh. published: the paper's real parts. exact hull: with the true rig, the limit of every hull.",
    )
    for name, summaries in summaries_of(plan.poses, result.trials).items():
        label = name
        if name in PUBLISHED_MM:
            mean_mm, max_mm = PUBLISHED_MM[name]
            table.add_row(
                name, "", "published", "", f"{mean_mm:.3f}", "" if max_mm is None else f"{max_mm:.3f}"
            )
            label = ""
        for summary in summaries:
            table.add_row(label, *_head(summary), *(_cells(summary) if summary.n_measured else ["-"]))
            label = ""
        table.add_section()
    return table


def size_table(plan: BenchPlan, result: BenchResult) -> Table:
    """Return bias and rms of the sizes that standards define, by body."""
    table = _table(
        f"errors of sizes, mm: bias (mean of measured less true) and rms over the same trials, lens {plan.lens},"
        f" seed {plan.seed}",
        HEAD,
        caption="true: the same functions on the true body's mesh. sieve: smallest square aperture; Feret: greatest "
        "and least caliper (EN 933-4); thickness: ASTM D4791.",
    )
    for column in ("sieve", "max Feret", "min Feret", "thickness"):
        table.add_column(column, justify="right", no_wrap=True)
    for name, summaries in summaries_of(plan.poses, result.trials).items():
        label = name
        for summary in summaries:
            bias, rms = summary.bias, summary.rms
            cells = [
                f"{bias_mm:+.3f}, {rms_mm:.3f}"
                for bias_mm, rms_mm in (
                    (bias.sieve_size_mm, rms.sieve_size_mm),
                    (bias.max_feret_mm, rms.max_feret_mm),
                    (bias.min_feret_mm, rms.min_feret_mm),
                    (bias.thickness_mm, rms.thickness_mm),
                )
            ]
            table.add_row(label, *_head(summary), *(cells if summary.n_measured else ["-"]))
            label = ""
        table.add_section()
    return table


def rig_lines(plan: BenchPlan, result: BenchResult) -> list[str]:
    """Return the error of each calibration against the true rig, and all failures by reason, as lines of text."""
    true_rig = as_built(nominal_rig(), plan.seed)
    lines = []
    for name, report in result.reports.items():
        error = rig_error(report.rig, true_rig)
        held_out = (
            "" if report.held_out_px is None else f"; {report.held_out_px:.3f} px rms in drops not used"
        )
        lines.append(
            f"rig {name}: {len(report.drops_used)} of {CALIBRATIONS[name][1]} drops used{held_out}; points in the"
            f" volume {1000 * error.rms_mm:.1f} um rms after a rigid motion, lengths {error.scale_percent:+.4f} %"
        )
        lines += [f"rig {name}: {problem.detail}" for problem in report.problems]
    lines += [f"rig {name}: no calibration: {reason}" for name, reason in result.refused.items()]
    for summary in summarize(result.trials):
        for reason, count in summary.failures.items():
            where = f"{summary.body}, rig {summary.rig}, {summary.method}"
            lines.append(f"{where}: {count} of {summary.n} without a body: {reason}")
    return lines


def paper_tables(plan: BenchPlan, result: BenchResult) -> list[Table]:
    """Return the paper's Tables 2 and 3 with both methods on the same images, its isolevels, and its Table 1."""
    return [
        _distance_table(plan, compare_with_paper(result.trials)),
        _isolevel_table(result),
        _time_table(result),
    ]


def performance_tables(times: Sequence[SizeTimes], seed: int) -> list[Table]:
    """Return the times of all stages, and those of the three kinds of body, with a row for each size of stones."""
    stages = _table(
        f"ms of processor time a stone on one thread, quickest of {N_RUNS} runs, medians of {times[0].n} stones a"
        f" size, seed {seed}; {_machine()}",
        right=("stone mm", *times[0].stages_ms, "all", "p95", "silhouettes to mesh", "GFLOP/s"),
        caption="all: frames to all measures of the estimated body; silhouettes to mesh: the hull, with integrals;"
        " GFLOP/s: of the processor meanwhile (product of matrices), 97 to 100 where the goals were found",
    )
    bodies = _table(
        "the same with each kind of body",
        right=(
            "stone mm", "hull", "estimate", "photo", "refinement", "texture", "file to result", "by the clock", "p95",
        ),
        caption="file to result: a bundle on disk to its durable result with the refined and textured body, photo",
    )  # fmt: skip
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
    grids = _table(
        f"ms of processor time from silhouettes to mesh, {stone}",
        right=("voxels", "faces", *scaling.grids[0].stages_ms),
    )
    for grid in scaling.grids:
        grids.add_row(f"{grid.n}^3", str(grid.n_faces), *(f"{ms:.1f}" for ms in grid.stages_ms.values()))
    grids.add_section()
    grids.add_row("grows as n^", "", *(f"{exponent:.2f}" for exponent in scaling.exponents().values()))

    views = _table(
        f"ms of processor time from frames to all measures, {stone}",
        right=("views", *scaling.views[0].stages_ms, "all", "a view"),
    )
    for row in scaling.views:
        figures_ms = (*row.stages_ms.values(), row.total_ms, row.total_ms / row.n_views)
        views.add_row(str(row.n_views), *(f"{ms:.1f}" for ms in figures_ms))

    workers = _table(
        f"{N_BUNDLES} times {stone}",
        right=("workers", "stones/s by the clock", "ms of processor time a stone"),
    )
    for each in scaling.workers:
        workers.add_row(str(each.n_workers), f"{each.stones_per_s:.1f}", f"{each.cpu_ms:.0f}")
    return [grids, views, workers]


def _table(
    title: str, left: Sequence[str] = (), right: Sequence[str] = (), caption: str | None = None
) -> Table:
    table = Table(title=title, caption=caption)
    for heading in left:
        table.add_column(heading, no_wrap=True)
    for heading in right:
        table.add_column(heading, justify="right")
    return table


def _head(summary: AccuracySummary) -> list[str]:
    n_measured = summary.n_measured
    count = str(summary.n) if n_measured == summary.n else f"{n_measured} of {summary.n}"
    return [summary.rig, summary.method, count]


def _cells(summary: AccuracySummary) -> list[str]:
    distances, bias = summary.distances, summary.bias
    return [
        f"{distances.mean_mm:.4f}",
        f"{distances.max_mm:.3f}",
        f"{distances.signed_mm:+.4f}",
        f"{distances.back_mean_mm:.4f}",
        f"{distances.back_max_mm:.3f}",
        f"{bias.mesh_volume_percent:+.2f}",
        f"{bias.volume_percent:+.2f}",
        f"{summary.rms.volume_percent:.2f}",
        f"{bias.area_percent:+.2f}",
    ]


def _distance_table(plan: BenchPlan, compared: Sequence[Compared]) -> Table:
    table = _table(
        f"distance to the true surface, mm: mean (mean of the greatest); lens {plan.lens}, seed {plan.seed}",
        ("body (n)",),
        caption="published: real parts and stones. paper's method: U2-Net's masks, Algorithm 1 from 8 balls, 256^3"
        " voxels counted, scikit-image at 15.5. its field: the same on our silhouettes. ratio: paper's by ours.",
    )
    for column in ("published", "paper's method", "its field, our silhouettes", "ours", "ratio"):
        table.add_column(column, justify="right", no_wrap=True)
    for each in compared:
        table.add_row(
            f"{each.body} ({each.n})",
            _pair(each.published_mm, each.published_max_mm),
            _pair(each.paper_mm, each.paper_max_mm),
            f"{each.paper_field_mm:.3f}",
            f"{each.ours_mm:.4f} ({each.ours_max_mm:.2f})",
            f"{each.ratio:.0f}",
        )
    return table


def _pair(mean_mm: float, max_mm: float | None) -> str:
    return f"{mean_mm:.3f}" + ("" if max_mm is None else f" ({max_mm:.2f})")


def _isolevel_table(result: BenchResult) -> Table:
    """Return mean distance, mm, and volume error, %, at 15.1, 15.5 and 15.9 for each body."""
    table = _table(
        "the paper's method by isolevel: mean distance, mm, and error of the mesh's volume, %",
        ("body",),
        [f"{isolevel:g}" for isolevel in sorted(ISOLEVELS.values())],
        caption="all on the same masks; between 15 and 16 the surface moves by less than a voxel, 0.195 mm",
    )
    for body in (*STANDARDS, *STONE_FORMS):
        if summaries := summarize([trial for trial in result.trials if trial.body == body]):
            levels = {ISOLEVELS[each.method]: each for each in summaries if each.method in ISOLEVELS}
            table.add_row(
                body,
                *(
                    f"{each.distances.mean_mm:.3f}, {each.bias.mesh_volume_percent:+.1f}"
                    for _, each in sorted(levels.items())
                ),
            )
    return table


def _time_table(result: BenchResult) -> Table:
    found = stage_seconds(result)
    table = Table(
        title="seconds a stone, 16 views",
        caption="published: i7-10700F, U2-Net on an RTX 3060. Here: median of the processor time on one core; "
        "reconstruction of ours has the estimate, the refinement and all measures in it.",
    )
    for column in ("", "published", *found):
        table.add_column(column, justify="right" if column else "left")
    for stage, published_s in PUBLISHED_S.items():
        table.add_row(stage, f"{published_s:.2f}", *(f"{times[stage]:.3f}" for times in found.values()))
    return table


def _machine() -> str:
    return f"{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}"
