"""Tables that `stonefall benchmark --accuracy` prints: distances, errors of volume and sizes, calibrations."""

from rich.table import Table

from pipeline.evaluation.scene import rig_error
from pipeline.rig.design import as_built, nominal_rig
from pipeline.synthesis.stones import STONE_FORMS
from service.commands.benchmarks.accuracy import (
    CALIBRATIONS,
    AccuracySummary,
    BenchPlan,
    BenchResult,
    summarize,
)
from service.commands.benchmarks.paper import PUBLISHED_MM, STONES


def accuracy_table(plan: BenchPlan, result: BenchResult) -> Table:
    """Return the averages by body, with the paper's published figures first where there are some."""
    table = Table(
        title=f"distance to the true surface, mm, and errors of volume and area; averages over"
        f" random poses or bodies, lens {plan.lens}, seed {plan.seed}",
        caption="max: mean of the greatest distances; back: true surface to measured one; volume: as reported, "
        "mesh: of the mesh. published: the paper's real parts. exact hull: with the true rig, the limit of every hull.",
    )
    for column in ("body", "rig", "method", "n"):
        table.add_column(column, no_wrap=True)
    for column in (
        "mean", "max", "signed", "back mean", "back max", "mesh %", "volume %", "rms %", "area %",
    ):  # fmt: skip
        table.add_column(column, justify="right")
    for name, summaries in summaries_of(plan, result).items():
        label = name
        if name in PUBLISHED_MM:
            mean_mm, max_mm = PUBLISHED_MM[name]
            table.add_row(
                name, "", "published", "", f"{mean_mm:.3f}", "" if max_mm is None else f"{max_mm:.3f}"
            )
            label = ""
        for summary in summaries:
            table.add_row(label, *_cells(summary))
            label = ""
        table.add_section()
    return table


def size_table(plan: BenchPlan, result: BenchResult) -> Table:
    """Return bias and rms of the sizes that standards define, by body."""
    table = Table(
        title=f"errors of sizes, mm: bias (mean of measured less true) and rms over the same trials, lens {plan.lens},"
        f" seed {plan.seed}",
        caption="true: the same functions on the true body's mesh. sieve: smallest square aperture; Feret: greatest "
        "and least caliper (EN 933-4); thickness: ASTM D4791.",
    )
    for column in ("body", "rig", "method", "n"):
        table.add_column(column, no_wrap=True)
    for column in ("sieve", "max Feret", "min Feret", "thickness"):
        table.add_column(column, justify="right", no_wrap=True)
    for name, summaries in summaries_of(plan, result).items():
        label = name
        for summary in summaries:
            table.add_row(label, *_head(summary), *(_size_cells(summary) if _n_measured(summary) else ["-"]))
            label = ""
        table.add_section()
    return table


def summaries_of(plan: BenchPlan, result: BenchResult) -> dict[str, list[AccuracySummary]]:
    """Return the averages of each body, and of all stones together if there are several classes."""
    summaries = {name: summarize([t for t in result.trials if t.body == name]) for name in plan.poses}
    stones = [trial for trial in result.trials if trial.body in STONE_FORMS]
    if len({trial.body for trial in stones}) > 1:
        summaries[STONES] = summarize(stones, STONES)
    return summaries


def _n_measured(summary: AccuracySummary) -> int:
    return summary.n - sum(summary.failures.values())


def _head(summary: AccuracySummary) -> list[str]:
    n_measured = _n_measured(summary)
    count = str(summary.n) if n_measured == summary.n else f"{n_measured} of {summary.n}"
    return [summary.rig, summary.method, count]


def _cells(summary: AccuracySummary) -> list[str]:
    if _n_measured(summary) == 0:
        return [*_head(summary), "-"]
    return [
        *_head(summary),
        f"{summary.mean_mm:.4f}",
        f"{summary.max_mm:.3f}",
        f"{summary.signed_mm:+.4f}",
        f"{summary.back_mean_mm:.4f}",
        f"{summary.back_max_mm:.3f}",
        f"{summary.mesh_volume_percent:+.2f}",
        f"{summary.volume_percent:+.2f}",
        f"{summary.volume_rms_percent:.2f}",
        f"{summary.area_percent:+.2f}",
    ]


def _size_cells(summary: AccuracySummary) -> list[str]:
    return [
        f"{bias_mm:+.3f}, {rms_mm:.3f}"
        for bias_mm, rms_mm in (
            (summary.sieve_size_mm, summary.sieve_size_rms_mm),
            (summary.max_feret_mm, summary.max_feret_rms_mm),
            (summary.min_feret_mm, summary.min_feret_rms_mm),
            (summary.thickness_mm, summary.thickness_rms_mm),
        )
    ]


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
