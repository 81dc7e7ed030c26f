"""What `tests/benchmarks/segmentation.py` says of segmenters: tables, a line below a picture, JSON."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table

from pipeline.evaluation.hard_cases import HardCase
from pipeline.evaluation.silhouette_errors import SilhouetteErrors
from pipeline.segmentation import Silhouette, ViewStatus

PLAIN, BACKGROUND, NETWORK, AUTO, U2NETP, MASK = (
    "plain", "background", "network", "auto", "u2netp", "u2netp mask",
)  # fmt: skip
"""What differs, to whole pixels; the service's three; U2-Net-p with the edge by grey levels; as the paper uses it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What one segmenter made of one view."""

    case: str
    number: int
    segmenter: str
    silhouette: Silhouette
    wanted: ViewStatus
    ms: float
    distance_ms: float
    errors: SilhouetteErrors | None  # where there is a silhouette, and should be

    @property
    def is_failure(self) -> bool:
        return self.silhouette.status is not self.wanted


def remark(outcome: Outcome) -> str:
    """One line below a picture."""
    errors = outcome.errors
    if errors is None:
        return str(outcome.silhouette.status) + (
            f", should be {outcome.wanted}" if outcome.is_failure else ""
        )
    return (
        f"IoU {errors.iou:.4f}, bias {errors.bias_px:+.3f} px, RMS {errors.rms_px:.3f} px,"
        f" unknown {errors.unknown_share:.1%}, {outcome.silhouette.found_by}"
    )


def accuracy_table(outcomes: Sequence[Outcome], title: str) -> Table:
    table = Table(
        title=f"{title}; IoU: median; bias and RMS in px: of the outlines where the true edge is visible; seen: of"
        " that edge; unknown: of the body's pixels; wrong: pixels beyond the rim"
    )
    for heading in (
        "case", "segmenter", "found by", "IoU", "worst IoU", "bias", "worst bias", "RMS", "seen %", "unknown %",
        "wrong %", "status right", "not right", "ms CPU", "10-90 %",
    ):  # fmt: skip
        table.add_column(heading, no_wrap=True)
    last_case = ""
    for group in grouped(outcomes, lambda each: (each.case, each.segmenter)):
        first = group[0]
        if first.case != last_case:
            table.add_section()
        found_by = Counter(each.silhouette.found_by for each in group if each.silhouette.is_usable)
        wrong = Counter(f"{each.silhouette.status} for {each.wanted}" for each in group if each.is_failure)
        ms = [each.ms for each in group]
        table.add_row(
            first.case if first.case != last_case else "",
            first.segmenter,
            ", ".join(f"{name} {count}" for name, count in found_by.items()),
            *error_cells([each.errors for each in group if each.errors is not None]),
            f"{sum(not each.is_failure for each in group)} of {len(group)}",
            ", ".join(f"{count} {name}" for name, count in wrong.items()),
            f"{np.median(ms):.1f}",
            f"{np.quantile(ms, 0.1):.1f}-{np.quantile(ms, 0.9):.1f}",
        )
        last_case = first.case
    return table


def error_cells(judged: Sequence[SilhouetteErrors]) -> list[str]:
    """From IoU to wrong pixels."""
    offsets_px = np.concatenate([np.zeros(0), *(errors.offsets_px for errors in judged)])
    if len(offsets_px) == 0:
        return ["-"] * 8
    ious = [errors.iou for errors in judged]
    return [
        f"{np.median(ious):.4f}",
        f"{min(ious):.4f}",
        f"{offsets_px.mean():+.3f}",
        f"{max((errors.bias_px for errors in judged if len(errors.offsets_px)), key=abs):+.3f}",
        f"{np.sqrt(np.mean(offsets_px**2)):.3f}",
        percent([errors.seen_share for errors in judged]),
        percent([errors.unknown_share for errors in judged]),
        percent([errors.wrong_share for errors in judged]),
    ]


def percent(shares: Sequence[float]) -> str:
    return f"{100 * np.nanmean(shares):.2f}"


def time_table(outcomes: Sequence[Outcome], plain: Sequence[float], bare: Sequence[float]) -> Table:
    """Of the clean views, and of all; the ratios are those of the medians over clean views.

    `plain` and `bare` are milliseconds of what the segmenters are compared with.
    """
    clean = [each for each in outcomes if each.case == HardCase.CLEAN] or outcomes
    medians_ms = {
        group[0].segmenter: float(np.median([each.ms for each in group]))
        for group in grouped(clean, lambda each: (each.segmenter,))
    }
    table = Table(
        "segmenter", "ms CPU a clean image", "16 of them", "images/s a core", "plain takes x", "x bare network",
        f"{MASK} takes x",
        "distance field, ms", "ms of all images", "10-90 %",
        title=f"{len(plain)} images, one thread; plain: absdiff, threshold, connectedComponentsWithStats of an image,"
        f" {np.median(plain):.2f} ms ({np.quantile(plain, 0.1):.2f}-{np.quantile(plain, 0.9):.2f}); bare network:"
        f" our own on its largest square, nothing else, {np.median(bare):.2f} ms",
    )  # fmt: skip
    for group in grouped(outcomes, lambda each: (each.segmenter,)):
        ms = [each.ms for each in group]
        distance_ms = [each.distance_ms for each in group if each.silhouette.is_usable]
        median_ms = medians_ms[group[0].segmenter]
        table.add_row(
            group[0].segmenter,
            f"{median_ms:.2f}",
            f"{16 * median_ms:.0f}",
            f"{1000 / median_ms:.0f}",
            f"{np.median(plain) / median_ms:.2f}",
            f"{median_ms / np.median(bare):.2f}",
            f"{medians_ms[MASK] / median_ms:.1f}" if MASK in medians_ms else "-",
            f"{np.median(distance_ms):.2f}" if distance_ms else "-",
            f"{np.median(ms):.2f}",
            f"{np.quantile(ms, 0.1):.2f}-{np.quantile(ms, 0.9):.2f}",
        )
    return table


def grouped(outcomes: Sequence[Outcome], key: Callable[[Outcome], tuple[str, ...]]) -> list[list[Outcome]]:
    groups: dict[tuple[str, ...], list[Outcome]] = {}
    for outcome in outcomes:
        groups.setdefault(key(outcome), []).append(outcome)
    return list(groups.values())


def as_json(outcome: Outcome) -> dict[str, Any]:
    errors = outcome.errors
    found = outcome.silhouette
    row: dict[str, Any] = {
        "case": outcome.case,
        "number": outcome.number,
        "segmenter": outcome.segmenter,
        "status": found.status,
        "wanted_status": outcome.wanted,
        "found_by": found.found_by,
        "fallback": found.fallback,
        "ms": outcome.ms,
        "distance_ms": outcome.distance_ms,
    }
    if errors is not None:
        names = ("iou", "bias_px", "rms_px", "seen_share", "unknown_share", "wrong_share")
        row |= {name: getattr(errors, name) for name in names}
    return row
