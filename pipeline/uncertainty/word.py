"""The word for a stone's uncertainty: good, reduced or degraded, and the causes that keep it from a better one."""

from dataclasses import dataclass
from math import hypot, inf

from pipeline.uncertainty.causes import Cause
from pipeline.uncertainty.model import Uncertainty
from pipeline.views.quality import Quality

BEST_FIRST = (Quality.GOOD, Quality.REDUCED, Quality.DEGRADED)


@dataclass(frozen=True, slots=True, kw_only=True)
class QualityParameters:
    """Standard deviations up to which a result is good or reduced; which causes count is `verdict`'s."""

    good_mm: float = 0.04
    good_volume_percent: float = 1.0
    reduced_mm: float = 0.1
    reduced_volume_percent: float = 2.0

    def __post_init__(self) -> None:
        if not (
            0 < self.good_mm <= self.reduced_mm
            and 0 < self.good_volume_percent <= self.reduced_volume_percent
        ):
            raise ValueError("quality needs 0 < good <= reduced, for mm and for percent of volume")


@dataclass(frozen=True, slots=True, kw_only=True)
class QualityVerdict:
    """The quality of a result, and why it is not better: the greatest cause first, none for a good one."""

    quality: Quality
    causes: tuple[Cause, ...] = ()


def verdict(
    found: Uncertainty, by_number: Quality, parameters: QualityParameters, hidden_as: Cause | None = None
) -> QualityVerdict:
    """Return the worse of the quality by the number of views and that by uncertainty, and its causes.

    Causes are named until without them the uncertainty would be that of a good result. Dents that no silhouette
    shows are left out where silhouettes alone were asked for (`hidden_as` is None): no view could be better for them.
    Where pixels inside the outlines were, dents that these do not show keep a result from being good, as the cause
    `hidden_as`: in better light, or with more time, they would.
    """
    p = parameters
    sds = {
        cause: (found.surface_mm[cause], found.volume_percent[cause])
        for cause in found.surface_mm
        if hidden_as is not None or cause is not Cause.HIDDEN
    }
    limits = (
        (Quality.GOOD, p.good_mm, p.good_volume_percent),
        (Quality.REDUCED, p.reduced_mm, p.reduced_volume_percent),
        (Quality.DEGRADED, inf, inf),
    )

    def quality_without(*left_out: Cause) -> Quality:
        kept = [sd for cause, sd in sds.items() if cause not in left_out]
        mm, percent = hypot(*(sd[0] for sd in kept)), hypot(*(sd[1] for sd in kept))
        return next(
            word for word, most_mm, most_percent in limits if mm <= most_mm and percent <= most_percent
        )

    by_sigma = quality_without()
    if by_sigma is Quality.DEGRADED and quality_without(Cause.HIDDEN) is not Quality.DEGRADED:
        by_sigma = Quality.REDUCED
    causes: list[Cause] = [Cause.VIEWS] if by_number is not Quality.GOOD else []
    worst_first = sorted(
        sds, key=lambda cause: -max(sds[cause][0] / p.good_mm, sds[cause][1] / p.good_volume_percent)
    )
    for n, cause in enumerate(worst_first):
        if quality_without(*worst_first[:n]) is Quality.GOOD:
            break
        named = hidden_as if cause is Cause.HIDDEN and hidden_as is not None else cause
        if named not in causes:
            causes.append(named)
    return QualityVerdict(quality=max(by_sigma, by_number, key=BEST_FIRST.index), causes=tuple(causes))
