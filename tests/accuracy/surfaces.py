"""Whether the refined body holds on every kind of surface: its errors beside the estimate's, through the whole chain.

Run: .venv/bin/python tests/accuracy/surfaces.py [--seed 31] [--count 2] [--lenses f8,f2] [--jobs 2]
     [--gloss 0.5] [--interreflection]

Dented and rough bodies of 10 to 36 mm with three textures, cubes and cylinders with the same, and bodies without
texture, black as nylon or grey, are rendered through each lens and measured with the true rig and with that calibrated
from 20 balls through the same lens. Distances are means in both directions; volumes are those reported.
"""

import argparse
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from research.accuracy import BenchPlan, BenchResult, RigName, run_accuracy_bench
from support.printed import show

from pipeline.evaluation.trials import STANDARDS, Trial, random_body
from pipeline.synthesis.bodies import Looks, SurfaceKind
from pipeline.synthesis.exposure import LensPreset

STONES = ("dented", "rough", "irregular")
TEXTURES = (SurfaceKind.MOTTLED, SurfaceKind.GRANITE, SurfaceKind.BANDED)
TEXTURED = Looks(surfaces=TEXTURES)
CONTRAST = 0.2
"""Of the textured cube and cylinder: that of stones."""
PLAIN_GREYS = {"black": 10.0, "grey": 60.0}
RIGS: tuple[RigName, ...] = ("true", "ours")

MAX_MEAN_MM = {LensPreset.F8: 0.025, LensPreset.F2: 0.03}
MAX_VOLUME_PERCENT, MAX_BIAS_PERCENT = 0.5, 0.2
MAX_CHANGE_MM, MAX_CHANGE_PERCENT = 0.002, 0.05
"""Of a body without texture, from its estimate."""
MAX_EDGE_MM = 0.05
"""By which the largest error of a textured cube or cylinder may exceed the estimate's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """The errors of one body's estimate and of its refined body."""

    surface: SurfaceKind
    estimate: Trial
    photo: Trial

    @property
    def body(self) -> str:
        return self.photo.body

    @property
    def rig(self) -> str:
        return self.photo.rig

    @property
    def change_mm(self) -> float:
        return mean_mm(self.photo) - mean_mm(self.estimate)

    @property
    def change_percent(self) -> float:
        return volume_percent(self.photo) - volume_percent(self.estimate)

    @property
    def change_of_largest_mm(self) -> float:
        return largest_mm(self.photo) - largest_mm(self.estimate)


@dataclass(frozen=True, slots=True)
class Goal:
    """A limit, and what was reached."""

    what: str
    reached: float
    limit: float

    @property
    def holds(self) -> bool:
        return self.reached <= self.limit


def mean_mm(trial: Trial) -> float:
    assert trial.distances is not None, trial.failure
    return (trial.distances.mean_mm + trial.distances.back_mean_mm) / 2


def largest_mm(trial: Trial) -> float:
    assert trial.distances is not None, trial.failure
    return max(trial.distances.max_mm, trial.distances.back_max_mm)


def volume_percent(trial: Trial) -> float:
    assert trial.errors is not None, trial.failure
    return trial.errors.volume_percent


def plan_of(
    seed: int,
    count: int,
    lens: LensPreset,
    rigs: Sequence[RigName] = RIGS,
    looks: Looks = TEXTURED,
) -> BenchPlan:
    """Return a plan of `count` bodies of each form and texture, and as many poses of those without any."""
    textured = {
        (full := f"textured {name}"): replace(STANDARDS[name](), name=full, contrast=CONTRAST)
        for name in ("cube", "cylinder")
    }
    plain = {
        (full := f"{word} {name}"): replace(
            random_body(name, 0, seed), name=full, surface=SurfaceKind.PLAIN, grey=grey
        )
        for word, grey in PLAIN_GREYS.items()
        for name in (*STANDARDS, "dented")
    }
    each_texture = (*STONES, *textured)
    return BenchPlan(
        poses=dict.fromkeys(each_texture, count * len(looks.surfaces)) | dict.fromkeys(plain, count),
        own_bodies=textured | plain,
        looks=dict.fromkeys(each_texture, looks),
        seed=seed,
        lens=lens,
        methods=dict.fromkeys(rigs, ("estimate", "photo")),
    )


def compared(plan: BenchPlan, result: BenchResult) -> list[Compared]:
    """Return the bodies that were measured, each with each rig."""
    by_method = {(trial.body, trial.number, trial.rig, trial.method): trial for trial in result.trials}
    return [
        Compared(
            surface=_surface(plan, body, number),
            estimate=estimate,
            photo=by_method[body, number, rig, "photo"],
        )
        for (body, number, rig, method), estimate in by_method.items()
        if method == "estimate" and estimate.failure is None
    ]


def _surface(plan: BenchPlan, body: str, number: int) -> SurfaceKind:
    if body in plan.looks:
        return plan.looks[body].surfaces[number % len(plan.looks[body].surfaces)]
    return plan.own_bodies[body].surface


def goals(found: Sequence[Compared], lens: LensPreset) -> Iterator[Goal]:
    """Return what must hold of the bodies measured with one rig."""
    stones = [each for each in found if each.body in STONES]
    percents = [volume_percent(each.photo) for each in stones]
    yield Goal("stones: mean distance, mm", fmean(mean_mm(each.photo) for each in stones), MAX_MEAN_MM[lens])
    yield Goal("stones: largest error of a volume, %", max(map(abs, percents)), MAX_VOLUME_PERCENT)
    yield Goal("stones: bias of volumes, %", abs(fmean(percents)), MAX_BIAS_PERCENT)
    plain = [each for each in found if each.surface is SurfaceKind.PLAIN]
    yield Goal(
        "plain bodies: change of distance, mm", max(abs(each.change_mm) for each in plain), MAX_CHANGE_MM
    )
    yield Goal(
        "plain bodies: change of volume, %",
        max(abs(each.change_percent) for each in plain),
        MAX_CHANGE_PERCENT,
    )
    for body in ("textured cube", "textured cylinder"):
        more_mm = max(each.change_of_largest_mm for each in found if each.body == body)
        yield Goal(f"{body}: largest error beyond the estimate's, mm", more_mm, MAX_EDGE_MM)


def errors_table(found: Sequence[Compared], title: str) -> Table:
    """Return one line for each rig, body and surface."""
    table = Table(title=title)
    for column in ("rig", "body", "surface", "n"):
        table.add_column(column, no_wrap=True)
    for column in (
        "estimate: mm", "photo: mm", "worst", "estimate: largest", "photo: largest",
        "estimate: volume %", "photo: volume %",
    ):  # fmt: skip
        table.add_column(column, justify="right")
    for key in dict.fromkeys((each.rig, each.body, each.surface) for each in found):
        group = [each for each in found if (each.rig, each.body, each.surface) == key]
        table.add_row(
            *key,
            str(len(group)),
            f"{fmean(mean_mm(each.estimate) for each in group):.4f}",
            f"{fmean(mean_mm(each.photo) for each in group):.4f}",
            f"{max(mean_mm(each.photo) for each in group):.4f}",
            f"{max(largest_mm(each.estimate) for each in group):.2f}",
            f"{max(largest_mm(each.photo) for each in group):.2f}",
            " ".join(f"{volume_percent(each.estimate):+.2f}" for each in group),
            " ".join(f"{volume_percent(each.photo):+.2f}" for each in group),
        )
    return table


def goals_table(goals_by_rig: Mapping[str, Sequence[Goal]], lens: LensPreset, title: str) -> Table:
    """Return one line for each goal, and whether it holds, with each rig."""
    table = Table(title=title)
    for column in ("lens", "goal", "limit", *goals_by_rig):
        table.add_column(column, justify="left" if column == "goal" else "right", no_wrap=True)
    for row in zip(*goals_by_rig.values(), strict=True):
        table.add_row(
            lens.value,
            row[0].what,
            f"{row[0].limit:g}",
            *(f"{goal.reached:.4f} {'ok' if goal.holds else 'missed'}" for goal in row),
        )
    return table


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=2, help="bodies of each form and texture")
    parser.add_argument("--lenses", default="f8,f2")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--gloss", type=float, default=0.0)
    parser.add_argument("--interreflection", action="store_true")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    looks = Looks(surfaces=TEXTURES, gloss=arguments.gloss, is_interreflecting=arguments.interreflection)
    console, tables = Console(stderr=True), []
    all_hold = True
    for lens in map(LensPreset, arguments.lenses.split(",")):
        plan = plan_of(arguments.seed, arguments.count, lens, looks=looks)
        result = run_accuracy_bench(plan, n_processes=arguments.jobs)
        found = compared(plan, result)
        by_rig = {
            rig: list(goals([each for each in found if each.rig == rig], lens))
            for rig in dict.fromkeys(each.rig for each in found)
        }
        title = f"lens {lens}, seed {plan.seed}, gloss {looks.gloss:g}, interreflection {looks.is_interreflecting}"
        tables += [errors_table(found, title), goals_table(by_rig, lens, title)]
        failures = [
            f"{trial.body} {trial.number}, {trial.rig}: {trial.failure}"
            for trial in result.trials
            if trial.failure
        ]
        console.print("\n".join([*failures, *(f"rig {rig}: {why}" for rig, why in result.refused.items())]))
        all_hold &= not failures and not result.refused
        all_hold &= all(goal.holds for rig_goals in by_rig.values() for goal in rig_goals)
    show(*tables, as_json=arguments.json)
    return 0 if all_hold else 1


if __name__ == "__main__":
    sys.exit(main())
