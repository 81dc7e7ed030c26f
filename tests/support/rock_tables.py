"""Rows of the bench `tests/accuracy/rock.py`, its table, and the kinds of failure that it is to show."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np
from rich.table import Table

from pipeline.arrays import Values

FAR_MM = 0.3
"""What is further off than this is lost: a dent, a bite, a tunnel."""
RIM_PX = 2
"""Body called background no deeper than this is an error of the outline, not of the comparison."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceErrors:
    """Distances between a measured and the true surface, both ways."""

    mean_mm: float
    rms_mm: float
    largest_mm: float
    far_percent: float  # of both surfaces, beyond `FAR_MM`


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One object of one seed with one rig; what is not measured is None."""

    rig: str
    name: str
    seed: int
    size_mm: float
    bitten_px: int  # body called background deeper than `RIM_PX`, in the worst view
    outline_px: float | None  # median over the views of the outline's mean error, positive outside
    n_views: int
    dropped: tuple[str, ...]
    rejection: str | None
    estimate: SurfaceErrors | None = None
    photo: SurfaceErrors | None = None
    volume_percent: float | None = None
    estimate_volume_percent: float | None = None
    sieve_percent: float | None = None
    sieve_sigmas: float | None = None  # error over the sigma that lots count with
    word: str | None = None
    causes: tuple[str, ...] = ()
    support: float | None = None
    fallback: str | None = None
    surface_sd_mm: float | None = None
    volume_sd_percent: float | None = None
    genus: int | None = None

    def __str__(self) -> str:
        """The row in a line, to show how far the bench is."""
        said = f"{self.name}, seed {self.seed}, {self.rig} rig: "
        if self.photo is None or self.estimate is None:
            return said + f"rejected, {self.rejection}"
        return said + (
            f"{self.estimate.mean_mm:.3f} -> {self.photo.mean_mm:.3f} mm, largest {self.photo.largest_mm:.2f},"
            f" {self.volume_percent:+.1f} %, {self.word}"
        )


def table(rows: Sequence[Row], title: str) -> Table:
    """Return one line for each rig and object: medians over the seeds and, behind a bar, the worst."""
    found = Table(title=title)
    for column in (
        "rig", "object", "n", "size mm", "estimate mm", "photo mm", "largest mm", "> 0.3 mm, %", "volume %",
        "sieve %", "word", "support", "sd mm", "rms mm", "volume sd %", "genus", "bitten px", "outline px",
        "views", "what happened",
    ):  # fmt: skip
        found.add_column(column, justify="left" if column in ("rig", "object", "word") else "right")
    for key in dict.fromkeys((row.rig, row.name) for row in rows):
        own = [row for row in rows if (row.rig, row.name) == key]
        found.add_row(
            *key,
            str(len(own)),
            " ".join(f"{row.size_mm:.0f}" for row in own),
            _both(own, lambda row: row.estimate and row.estimate.mean_mm, ".3f"),
            _both(own, lambda row: row.photo and row.photo.mean_mm, ".3f"),
            _both(own, lambda row: row.photo and row.photo.largest_mm, ".2f"),
            _both(own, lambda row: row.photo and row.photo.far_percent, ".2f"),
            _both(own, lambda row: row.volume_percent, "+.1f"),
            _both(own, lambda row: row.sieve_percent, "+.1f"),
            _counted(" ".join([row.word, *row.causes]) for row in own if row.word),
            _both(own, lambda row: row.support, ".2f", least=True),
            _both(own, lambda row: row.surface_sd_mm, ".3f"),
            _both(own, lambda row: row.photo and row.photo.rms_mm, ".3f"),
            _both(own, lambda row: row.volume_sd_percent, ".1f"),
            _both(own, lambda row: row.genus, ".0f"),
            _both(own, lambda row: row.bitten_px, ".0f"),
            _both(own, lambda row: row.outline_px, "+.2f"),
            _both(own, lambda row: row.n_views, ".0f", least=True),
            _counted(what for row in own for what in _happened(row)),
        )
    return found


PROMISED_MM, PROMISED_PERCENT = 0.04, 1.0
"""Errors of surface and volume up to which a result may be called good."""


def summary_table(rows: Sequence[Row]) -> Table:
    """Return one line for each rig, for stones and for standards: errors, their ratios to the sigmas stated, words."""
    found = Table(title="all of a kind")
    for column in (
        "rig", "kind", "n", "rejected", "mean mm", "largest mm", "> 0.3 mm, %", "volume %: mean", "volume rms %",
        "sieve rms %", "error / sigma: surface, rms", "volume error / sigma: rms", "volume within 2 sigma, %",
        "sieve error / sigma: rms",
        "good / reduced / degraded", "within 0.04 mm and 1 %: good", "good beyond them",
    ):  # fmt: skip
        found.add_column(column, justify="left" if column in ("rig", "kind") else "right")
    for rig in dict.fromkeys(row.rig for row in rows):
        for kind in ("stones", "standards"):
            of_kind = [
                row
                for row in rows
                if row.rig == rig
                and row.name.startswith(("sphere", "cylinder", "cube")) == (kind == "standards")
            ]
            own = [row for row in of_kind if row.photo is not None]
            if not own:
                continue
            errors = [row.photo for row in own if row.photo is not None]
            volume = np.array([row.volume_percent for row in own])
            sieve = np.array([row.sieve_percent for row in own])
            rms_mm = np.array([error.rms_mm for error in errors])
            sigmas = rms_mm / np.array([row.surface_sd_mm for row in own])
            volume_sigmas = volume / np.array([row.volume_sd_percent for row in own])
            is_good = np.array([row.word == "good" for row in own])
            is_within = (rms_mm <= PROMISED_MM) & (np.abs(volume) <= PROMISED_PERCENT)
            words = Counter(row.word for row in own)
            found.add_row(
                rig,
                kind,
                str(len(of_kind)),
                str(len(of_kind) - len(own)),
                f"{np.mean([error.mean_mm for error in errors]):.3f}",
                f"{max(error.largest_mm for error in errors):.1f}",
                f"{np.mean([error.far_percent for error in errors]):.2f}",
                f"{volume.mean():+.2f}",
                f"{_rms(volume):.2f}",
                f"{_rms(sieve):.2f}",
                f"{_rms(sigmas):.2f}",
                f"{_rms(volume_sigmas):.2f}",
                f"{100 * (np.abs(volume_sigmas) < 2).mean():.0f}",
                f"{_rms(np.array([row.sieve_sigmas for row in own])):.2f}",
                " / ".join(str(words[word]) for word in ("good", "reduced", "degraded")),
                f"{(is_good & is_within).sum()} of {is_within.sum()}",
                str((is_good & ~is_within).sum()),
            )
    return found


def _rms(values: Values) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _both(
    rows: Sequence[Row], value: Callable[[Row], float | None], digits: str, *, least: bool = False
) -> str:
    values = [number for row in rows if (number := value(row)) is not None]
    if not values:
        return "-"
    worst = min(values) if least else max(values, key=abs)
    return f"{median(values):{digits}} | {worst:{digits}}"


def _counted(words: Iterable[str]) -> str:
    counts = Counter(words)
    return "; ".join(word if n == 1 else f"{word} x {n}" for word, n in counts.items())


def _happened(row: Row) -> Iterator[str]:
    if row.rejection is not None:
        yield f"rejected, {row.rejection}"
    if row.fallback is not None:
        yield row.fallback
    yield from (f"{n} {why}" for why, n in Counter(row.dropped).items())


@dataclass(frozen=True, slots=True)
class Failure:
    """A kind of failure that images of another renderer have shown, and whether an object shows it here."""

    what: str
    objects: Callable[[str], bool]
    is_shown: Callable[[Row], bool]


def _far(row: Row, least_mm: float) -> bool:
    return row.photo is not None and row.photo.largest_mm > least_mm


FAILURES = (
    Failure("limestone rejected unseen", "limestone".__eq__, lambda row: "unseen" in (row.rejection or "")),
    Failure("basalt 5 % too large", lambda name: "basalt" in name, lambda row: (row.volume_percent or 0) > 5),
    Failure(
        "basalt 5 % too large and good",
        "basalt 18, bare wall".__eq__,
        lambda row: (row.volume_percent or 0) > 5 and row.word == "good",
    ),
    Failure(
        "tunnel or bite of 3 mm before one spot",
        "cube, one spot".__eq__,
        lambda row: (row.genus or 0) > 0 or _far(row, 3.0),
    ),
    Failure(
        "sphere right to 0.005 mm, not good",
        "sphere".__eq__,
        lambda row: row.photo is not None and row.photo.mean_mm < 0.005 and row.word != "good",
    ),
    Failure(
        "a stated sigma three times the error",
        lambda name: True,
        lambda row: row.photo is not None and (row.surface_sd_mm or 0) > 3 * row.photo.rms_mm,
    ),
    Failure("granite: 0.7 mm off somewhere", lambda name: "granite" in name, lambda row: _far(row, 0.7)),
    Failure("refinement given up over folds", lambda name: True, lambda row: "cross" in (row.fallback or "")),
    Failure("wet: outline 0.2 px too far in", "granite wet".__eq__, lambda row: (row.outline_px or 0) < -0.2),
    Failure(
        "cube's sieve size 1 % off",
        lambda name: name in ("cube", "cube, bright"),
        lambda row: abs(row.sieve_percent or 0) > 1,
    ),
    Failure(
        "view dropped for several bodies",
        lambda name: True,
        lambda row: any("multiple" in why for why in row.dropped),
    ),
)


def failures_table(rows: Sequence[Row]) -> Table:
    """Return for each kind of failure how many of its objects show it, and which."""
    found = Table("failure", "shown", "by")
    for failure in FAILURES:
        own = [row for row in rows if failure.objects(row.name)]
        shown = [f"{row.name} ({row.rig}, {row.seed})" for row in own if failure.is_shown(row)]
        found.add_row(failure.what, f"{len(shown)} of {len(own)}", ", ".join(shown))
    return found
