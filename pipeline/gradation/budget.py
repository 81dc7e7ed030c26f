"""Uncertainty budgets of the main figures: the variance that their intervals rest on, by its causes.

A standard error of an estimate is that of the stones seen. An interval of a share allows for those that happened not to
fall as well, so that no flaky stone among a hundred is not a flakiness of 0 without doubt; so do these budgets.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from pipeline.gradation.curve import SizeQuantile, passes, unseen_at
from pipeline.gradation.estimators import Basis, Property, Sample, Share, share_of
from pipeline.gradation.indices import FlakinessFraction, is_flaky, is_non_cubical
from pipeline.gradation.sieves import MeasuredRange
from pipeline.schema import SCHEMA

COVERAGE_FACTOR = 2.0
"""k of JCGM 100:2008, 6.3.3: about 95 % of a normal distribution."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UncertaintyBudget:
    """Uncertainty of a figure by its causes, in the unit of its name (JCGM 100:2008, GUM)."""

    __pydantic_config__ = SCHEMA

    figure: str
    """Name: `d50_mm` (from the stones themselves), `flakiness_percent`, `shape_percent`"""
    value: float
    """The figure"""
    sampling: float
    """Standard uncertainty for the stones that happened to fall, and those that happened not to"""
    instrument: float
    """Standard uncertainty for the random errors of each stone, those of the residuals of the calibration included"""
    scale: float
    """Standard uncertainty for the scale of the calibration, which all stones share"""
    combined: float
    """Combined standard uncertainty: the root of the sum of their squares (5.1.2)"""
    coverage_factor: float
    """k, for a level of confidence of about 95 % with many stones"""
    expanded: float
    """Expanded uncertainty U = k times the combined one (6.2.1)"""
    interval_factor: float
    """Student's t, which the 95 % interval of the figure has in the place of k: greater with few stones (G.3)"""


def budgets_of(
    sample: Sample,
    median: SizeQuantile | None,
    fractions: Sequence[FlakinessFraction],
    measured: MeasuredRange,
) -> Iterator[UncertaintyBudget]:
    """Yield the budgets of the main figures that have a value; `median` is D50, from the stones themselves."""
    size = None if median is None else median.size_mm
    if size is not None and size.value is not None and size.low is not None and size.high is not None:
        share = _share(sample, passes(size.value), unseen_at(sample, size.value))
        if share is not None:
            mm_per_share = (size.high - size.low) / (share.interval[1] - share.interval[0])
            yield _budget("d50_mm", size.value, share, mm_per_share)
    for name, property_ in (
        ("flakiness_percent", is_flaky(measured, fractions)),
        ("shape_percent", is_non_cubical(measured)),
    ):
        share = _share(sample, property_, None)
        if share is not None:
            yield _budget(name, 100 * share.value, share, 100)


def _share(sample: Sample, property_: Property, unseen_weight: float | None) -> Share | None:
    return share_of(sample, property_, *sample.weights(Basis.MASS), unseen_weight=unseen_weight)


def _budget(figure: str, value: float, share: Share, unit: float) -> UncertaintyBudget:
    errors = share.interval_errors.times(unit)
    return UncertaintyBudget(
        figure=figure,
        value=value,
        sampling=errors.sampling,
        instrument=errors.measuring,
        scale=errors.systematic,
        combined=errors.joined,
        coverage_factor=COVERAGE_FACTOR,
        expanded=COVERAGE_FACTOR * errors.joined,
        interval_factor=share.reach,
    )
