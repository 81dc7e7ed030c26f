"""The word for a stone's uncertainty: good, reduced or degraded, and the causes that keep it from a better one."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot, inf

from pipeline.uncertainty.causes import Cause
from pipeline.uncertainty.model import Uncertainty
from pipeline.views.quality import Quality

BEST_FIRST = (Quality.GOOD, Quality.REDUCED, Quality.DEGRADED)


@dataclass(frozen=True, slots=True, kw_only=True)
class QualityParameters:
    """Standard deviations up to which a result is good or reduced, without what no silhouette can show."""

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
    found: Uncertainty, by_number: Quality, parameters: QualityParameters, is_by_pixels: bool = False
) -> QualityVerdict:
    """Return the worse of the quality by the number of views and that by uncertainty, and its causes.

    Causes are named until without them the uncertainty would be that of a good result. Dents that no silhouette
    shows are left out where silhouettes alone were asked for: no view could be better for them. Where pixels inside
    the outlines were, dents that these do not show keep a result from being good: in better light they would.
    """
    p = parameters
    by_mm, by_volume = (
        {cause: sd for cause, sd in sds.items() if is_by_pixels or cause is not Cause.HIDDEN}
        for sds in (found.surface_mm, found.volume_percent)
    )
    limits = (
        (Quality.GOOD, p.good_mm, p.good_volume_percent),
        (Quality.REDUCED, p.reduced_mm, p.reduced_volume_percent),
        (Quality.DEGRADED, inf, inf),
    )

    def quality_of(without: tuple[Cause, ...] = ()) -> Quality:
        mm, percent = (
            hypot(*(sd for cause, sd in sds.items() if cause not in without)) for sds in (by_mm, by_volume)
        )
        return next(
            word for word, most_mm, most_percent in limits if mm <= most_mm and percent <= most_percent
        )

    by_sigma = quality_of()
    if by_sigma is Quality.DEGRADED and quality_of((Cause.HIDDEN,)) is not Quality.DEGRADED:
        by_sigma = Quality.REDUCED
    causes = [Cause.VIEWS] if by_number is not Quality.GOOD else []
    left = sorted(
        by_volume,
        key=lambda cause: -max(_sd(by_mm, cause) / p.good_mm, by_volume[cause] / p.good_volume_percent),
    )
    while left and (
        hypot(*(by_mm[cause] for cause in left if cause in by_mm)) > p.good_mm
        or hypot(*(by_volume[cause] for cause in left)) > p.good_volume_percent
    ):
        cause = left.pop(0)
        if cause not in causes:
            causes.append(cause)
    return QualityVerdict(quality=max(by_sigma, by_number, key=BEST_FIRST.index), causes=tuple(causes))


def _sd(sds: Mapping[Cause, float], cause: Cause) -> float:
    return sds.get(cause, 0.0)
