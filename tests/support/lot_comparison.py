"""A lot as it was measured beside the same stones as they are, and the goals of that."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot

import numpy as np
from support.rendered_lots import ALL_CAMERAS, Row

from pipeline.arrays import Values
from pipeline.gradation.estimates import Estimate, State
from pipeline.gradation.evaluation import Gradation, evaluate
from pipeline.gradation.sieves import OF_THE_RIG
from pipeline.gradation.stones import Lot, Stone, UnmeasuredStone, lot_of
from pipeline.uncertainty.evidence import LENGTH_SD_PERCENT
from service.lots.figures import shares_of
from service.lots.standards import read_standards

SETS = ("en-basic-2", "r20", "astm-c136")
MAX_POINTS, MAX_POINTS_OF_PAIRS, MAX_FLAKINESS, MAX_SHAPE, MIN_AGREEMENT_PERCENT = 1.0, 2.5, 1.0, 1.5, 95.0
SCALE_SD = LENGTH_SD_PERCENT / 100
LEAST_SD = 0.001
"""Standard deviation of a figure below which two values count as equal."""
N_ANYWHERE = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A figure of the lot beside the truth."""

    name: str
    true: float
    found: Estimate
    goal: float | None = None  # greatest difference

    @property
    def difference(self) -> float:
        return (self.found.value or 0.0) - self.true

    @property
    def sigmas(self) -> float:
        """Difference over what the lot states of measuring alone: the same stones were sieved."""
        sd = hypot(self.found.errors.measuring, self.found.errors.systematic)
        return abs(self.difference) / max(sd, LEAST_SD)

    @property
    def is_held(self) -> bool:
        """Whether the stated interval holds the truth."""
        low, high = self.found.low, self.found.high
        return low is not None and high is not None and low - LEAST_SD <= self.true <= high + LEAST_SD

    @property
    def is_reached(self) -> bool:
        return self.goal is None or abs(self.difference) <= self.goal


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """A lot as measured by some cameras, beside the same stones as they are."""

    cameras: str
    rejected: Mapping[str, int]
    rejected_mass_percent: float  # of the true mass of all stones
    at_most_percent: float | None  # of the measured mass, that the lot says may be missing
    agreement_percent: Mapping[str, float]  # stones in their true class, by sieve set
    passing: Mapping[str, Sequence[Figure]]  # by sieve set
    indices: Sequence[Figure]
    rms_anywhere: float  # of the passing at any sieve, in points
    within_a_point_percent: float  # of all sieves

    @property
    def figures(self) -> list[Figure]:
        return [*(figure for figures in self.passing.values() for figure in figures), *self.indices]

    @property
    def is_of_all(self) -> bool:
        return self.cameras == ALL_CAMERAS

    def greatest(self, name: str) -> Figure:
        """Return the passing of a set that differs most from the truth."""
        return max(self.passing[name], key=lambda figure: abs(figure.difference))


def comparison(rows: Sequence[Row], cameras: str = ALL_CAMERAS) -> Comparison:
    """Compare the lot that these cameras measured with the truth."""
    found = [row.found[cameras] for row in rows]
    is_measured = np.array([isinstance(each, Stone) for each in found])
    masses = np.array([row.true.volume_mm3 for row in rows])
    truth = lot_of(row.true for row, is_in in zip(rows, is_measured, strict=True) if is_in)
    lot = lot_of(found)
    sets = {name: read_standards().sieve_sets[name].apertures_mm for name in SETS}
    of_truth = {name: evaluate(truth, apertures_mm) for name, apertures_mm in sets.items()}
    of_lot = {name: evaluate(lot, apertures_mm, scale_sd=SCALE_SD) for name, apertures_mm in sets.items()}
    anywhere = differences_anywhere(truth, lot)
    goal = MAX_POINTS if cameras == ALL_CAMERAS else MAX_POINTS_OF_PAIRS
    return Comparison(
        cameras=cameras,
        rejected=Counter(each.reason for each in found if isinstance(each, UnmeasuredStone)),
        rejected_mass_percent=100 * float(masses[~is_measured].sum() / masses.sum()),
        at_most_percent=of_lot[SETS[0]].unmeasured.at_most_percent,
        agreement_percent={
            name: agreement_percent(truth, lot, apertures) for name, apertures in sets.items()
        },
        passing={name: passing_figures(of_truth[name], of_lot[name], goal) for name in SETS},
        indices=index_figures(of_truth[SETS[0]], of_lot[SETS[0]]),
        rms_anywhere=float(np.sqrt(np.mean(anywhere**2))),
        within_a_point_percent=100 * float(np.mean(np.abs(anywhere) <= MAX_POINTS)),
    )


def agreement_percent(truth: Lot, lot: Lot, apertures_mm: Sequence[float]) -> float:
    """Return how many stones are in the class, between two neighbouring sieves, that they are truly in."""
    classes = (np.searchsorted(apertures_mm, each.column("sieve_size_mm")) for each in (truth, lot))
    return 100 * float(np.mean(np.equal(*classes)))


def differences_anywhere(truth: Lot, lot: Lot) -> Values:
    """Return the difference of the passing at many sieves between the least and the largest stone, in points.

    Whether a heavy stone lies at one of the sieves of a set is chance; these do not depend on it.
    """
    sizes_mm = truth.column("sieve_size_mm")
    sieves_mm = np.geomspace(sizes_mm.min(), sizes_mm.max(), N_ANYWHERE)
    of_truth, of_lot = (
        (each.column("sieve_size_mm")[:, None] <= sieves_mm).T
        @ each.column("volume_mm3")
        / each.column("volume_mm3").sum()
        for each in (truth, lot)
    )
    return np.asarray(100 * (of_lot - of_truth))


def passing_figures(truth: Gradation, lot: Gradation, goal: float) -> list[Figure]:
    """Return the passing by mass at each sieve of the measured range."""
    return [
        Figure(name=f"{mine.sieve_mm:g} mm", true=true.by_mass.value, found=mine.by_mass, goal=goal)
        for true, mine in zip(truth.curve, lot.curve, strict=True)
        if mine.sieve_mm in OF_THE_RIG and true.by_mass.value is not None
    ]


def index_figures(truth: Gradation, lot: Gradation) -> list[Figure]:
    """Return indices and quantiles."""
    true, mine = truth.indices, lot.indices
    figures = {
        "flakiness index": (true.flakiness_percent, mine.flakiness_percent, MAX_FLAKINESS),
        "shape index": (true.shape_percent, mine.shape_percent, MAX_SHAPE),
        "needle-flaky": (true.needle_flaky_percent, mine.needle_flaky_percent, None),
        "fineness modulus": (true.fineness_modulus, mine.fineness_modulus, None),
    }
    shares = zip(shares_of(true.flat_and_elongated), shares_of(mine.flat_and_elongated), strict=True)
    for (ratio, name, basis, of_true), (*_, of_mine) in shares:
        if ratio == 3:
            form = name.removesuffix("_percent").replace("_", " ")
            figures[f"D4791 {form} 3:1 by {basis}"] = (of_true, of_mine, None)
    for percent, found in lot.quantiles_exact_mm.items():
        figures[f"D{percent}, mm"] = (truth.quantiles_exact_mm[percent], found, None)
    return [
        Figure(name=name, true=of_true.value, found=of_mine, goal=goal)
        for name, (of_true, of_mine, goal) in figures.items()
        if of_true.value is not None
    ]


def missed(found: Comparison) -> list[str]:
    """Return the goals that are missed; without two cameras there are only those of the passing."""
    judged = found.figures if found.is_of_all else [figure for of in found.passing.values() for figure in of]
    where = f"cameras {found.cameras}"
    said = [
        f"{where}: {figure.name} differs by {figure.difference:+.2f} from {figure.true:.2f}"
        for figure in judged
        if not figure.is_reached
    ]
    if found.is_of_all:
        said += [
            f"{where}: {figure.name} {figure.true:.2f} is outside of its interval"
            for figure in judged
            if not figure.is_held and figure.found.state is State.MEASURED
        ]
        said += [
            f"{where}: {percent:.1f} % of the stones are in their true class of {name}"
            for name, percent in found.agreement_percent.items()
            if percent < MIN_AGREEMENT_PERCENT
        ]
    return list(dict.fromkeys(said))  # sieves are in more than one set
