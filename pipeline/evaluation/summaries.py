"""Averages over accuracy trials, by body, rig and method; the paper's tables, published and on the same images."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from math import sqrt
from statistics import fmean
from typing import Any, TypeVar

from pipeline.evaluation.surface_distances import SurfaceDistances
from pipeline.evaluation.trials import STANDARDS, Method, ShapeErrors, Trial
from pipeline.synthesis.stones import STONE_FORMS

STONES = "stones"
"""Stones of all forms together."""
PUBLISHED_MM: Mapping[str, tuple[float, float | None]] = {
    "sphere": (0.233, 0.655),
    "cylinder": (0.268, 0.773),
    "cube": (0.289, 0.374),
    STONES: (0.434, None),
}
"""Mean and greatest distance of the paper's Tables 2 and 3: real parts, real stones."""

Figures = TypeVar("Figures", SurfaceDistances, ShapeErrors)


@dataclass(frozen=True, slots=True, kw_only=True)
class AccuracySummary:
    """Averages over the trials of one body, rig and method, without failures; NaN where there is none."""

    body: str
    rig: str
    method: Method
    n: int
    failures: Mapping[str, int]  # number of trials without a body, by reason
    distances: SurfaceDistances  # means; max: of the greatest distances
    bias: ShapeErrors  # means of measured less true
    rms: ShapeErrors

    @property
    def n_measured(self) -> int:
        return self.n - sum(self.failures.values())

    def document(self) -> dict[str, Any]:
        """Return all averages in one JSON-ready object; the rms of `x_mm` is `x_rms_mm`."""
        document: dict[str, Any] = {
            "body": self.body,
            "rig": self.rig,
            "method": self.method,
            "n": self.n,
            "failures": dict(self.failures),
            **asdict(self.distances),
        }
        for name, value in asdict(self.bias).items():
            document[name] = value
            if name not in ("mesh_volume_percent", "area_percent"):
                quantity, _, unit = name.rpartition("_")
                document[f"{quantity}_rms_{unit}"] = getattr(self.rms, name)
        return document


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """Distances to the true surface of one kind of body, mm: published, and by both methods on the same images."""

    body: str
    n: int
    published_mm: float
    published_max_mm: float | None
    paper_mm: float
    """By the paper's method as a whole."""
    paper_max_mm: float
    paper_field_mm: float
    """By its calibration and its field on our silhouettes."""
    ours_mm: float
    ours_max_mm: float

    @property
    def ratio(self) -> float:
        """Error of the paper's method by the error of ours, on the same images."""
        return self.paper_mm / self.ours_mm


def summarize(trials: Sequence[Trial], body: str | None = None) -> list[AccuracySummary]:
    """Return a summary for each body, rig and method, in the order of the trials; `body` is one name for all bodies."""
    groups: dict[tuple[str, str, Method], list[Trial]] = {}
    for trial in trials:
        groups.setdefault((body or trial.body, trial.rig, trial.method), []).append(trial)
    found = []
    for (name, rig, method), group in groups.items():
        errors = [trial.errors for trial in group if trial.errors is not None]
        found.append(
            AccuracySummary(
                body=name,
                rig=rig,
                method=method,
                n=len(group),
                failures=Counter(trial.failure for trial in group if trial.failure is not None),
                distances=_each(
                    SurfaceDistances, _mean, [trial.distances for trial in group if trial.distances]
                ),
                bias=_each(ShapeErrors, _mean, errors),
                rms=_each(ShapeErrors, lambda values: sqrt(_mean(value**2 for value in values)), errors),
            )
        )
    return found


def summaries_of(bodies: Iterable[str], trials: Sequence[Trial]) -> dict[str, list[AccuracySummary]]:
    """Return the averages of each body, and of all stones together if there are several classes."""
    summaries = {name: summarize([trial for trial in trials if trial.body == name]) for name in bodies}
    stones = [trial for trial in trials if trial.body in STONE_FORMS]
    if len({trial.body for trial in stones}) > 1:
        summaries[STONES] = summarize(stones, STONES)
    return summaries


def compare_with_paper(trials: Sequence[Trial]) -> list[Compared]:
    """Return the rows of the paper's Tables 2 and 3: published, by its method and by ours on the same images."""
    found = []
    for body in (*STANDARDS, STONES):
        of_body = [t for t in trials if t.body == body or (body == STONES and t.body in STONE_FORMS)]
        by_method = {(each.rig, each.method): each for each in summarize(of_body, body)}
        if ("paper", "paper's method") not in by_method or ("ours", "photo") not in by_method:
            continue
        paper, ours = by_method["paper", "paper's method"].distances, by_method["ours", "photo"]
        published_mm, published_max_mm = PUBLISHED_MM[body]
        found.append(
            Compared(
                body=body,
                n=ours.n,
                published_mm=published_mm,
                published_max_mm=published_max_mm,
                paper_mm=paper.mean_mm,
                paper_max_mm=paper.max_mm,
                paper_field_mm=by_method["paper", "paper's field"].distances.mean_mm,
                ours_mm=ours.distances.mean_mm,
                ours_max_mm=ours.distances.max_mm,
            )
        )
    return found


def _each(
    kind: type[Figures], average: Callable[[Iterable[float]], float], measured: Sequence[Figures]
) -> Figures:
    """Return the averages of each field."""
    return kind(
        **{field.name: average(getattr(each, field.name) for each in measured) for field in fields(kind)}
    )


def _mean(values: Iterable[float]) -> float:
    found = list(values)
    return fmean(found) if found else float("nan")
