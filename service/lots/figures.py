"""The figures of a lot as REST returns them and the report prints them."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Annotated, Any

from pydantic import Field, PlainSerializer, WithJsonSchema

from pipeline.gradation.budget import UncertaintyBudget
from pipeline.gradation.d4791 import DIMENSIONS, FlatAndElongated
from pipeline.gradation.estimates import Estimate
from pipeline.gradation.estimators import Property
from pipeline.gradation.indices import INDICES, ShapeIndices, is_flaky, is_non_cubical
from pipeline.gradation.sieves import MeasuredRange
from pipeline.gradation.specification import Decision
from pipeline.gradation.stones import Unmeasured
from service.base.schema import OptionalTime
from service.base.status import Report
from service.lots.lots import LotDocument
from service.lots.outcome import LotOutcome


class CurveStep(Report):
    """The gradation at one sieve."""

    sieve_mm: float = Field(description="Aperture of the sieve, square holes (EN 933-2, ASTM E11), mm")
    passing_percent: Estimate = Field(description="By mass")
    passing_by_number_percent: Estimate = Field(description="Share of the stones, by number, that pass, %")
    decision: Decision | None = Field(description="Null where the specification has no limits")


class CorrelatedStep(Report):
    """The gradation at one sieve, as the laboratory's sieves would find it."""

    sieve_mm: float = Field(description="Aperture of the sieve, mm")
    passing_percent: Estimate = Field(description="Passing by mass (EN 933-1), %")


class CorrelatedCurve(Report):
    """The curve by the product's correlation study, beside the raw one."""

    version: int = Field(description="Of the study")
    factor: float = Field(description="Sieve's size by the instrument's")
    n_lots: int = Field(description="Lots that the study rests on")
    held_out_rmse: float | None = Field(description="Points of passing, on lots that it was not fitted to")
    curve: list[CorrelatedStep] = Field(description="By rising sieve")


def _whole(percent: float) -> float:
    return int(percent) if percent == int(percent) else percent


QuantileShare = Annotated[float, PlainSerializer(_whole, return_type=Any), WithJsonSchema({"type": "number"})]
"""A whole number where it is one: 50, 2.5."""


class Quantile(Report):
    """A size that a share of the mass is smaller than; the two are different figures, and never mixed."""

    percent: QuantileShare = Field(description="Share of the mass, %: 50 is the median D50")
    interpolated_mm: Estimate = Field(description="Log-linear between neighbouring sieves")
    exact_mm: Estimate = Field(description="From the stones themselves")


class ProductDocument(Report):
    """The version of a product that a lot is of."""

    product: str = Field(description="Id of the product")
    version: int = Field(description="Version of the product")
    title: str = Field(description="Name of the product for people")
    density_kg_m3: float = Field(description="Density of the particles, EN 1097-6, kg/m³")
    specification: str | None = Field(description="Specification that it is judged by; null: none")


class LotFigures(LotOutcome):
    """All figures of the stones of a lot, or of a time."""

    lot: LotDocument | None = Field(description="Null for a window, a shift, and results without a store")
    product: ProductDocument | None = Field(description="Version of the product; null without one")
    since: OptionalTime = Field(description="First stone, RFC 3339 UTC")
    until: OptionalTime = Field(description="Last stone")
    triggers: int = Field(description="measured + rejected + lost")
    by_quality: Mapping[str, int] = Field(description="Measured stones by quality")
    by_body: Mapping[str, int] = Field(
        description="Measured stones by the body that was measured, `photo`, `estimate` or `hull`; results of earlier"
        " versions that were removed are not among them"
    )
    not_refined: Mapping[str, int] = Field(
        description="Estimates that pixels did not refine although `[body] kind` is `photo`: `rush`, other stones were"
        " waiting (they can be measured again); `no_evidence`, the pixels showed nothing that could be used"
    )
    mass_kg: float | None = Field(description="Of the measured stones; null without a density")
    n_effective: float = Field(
        description="Effective sample size: number of equal-mass stones with the same sampling error"
    )
    sieve_set: str = Field(description="Sieves that were used")
    specification: str | None = Field(description="Specification that was judged by; null: none")
    specification_source: str | None = Field(description="Standard or site that the specification is from")
    specification_is_general: bool = Field(
        default=False,
        description="True when its limits are general knowledge of the standard, not compared with its text",
    )
    curve: list[CurveStep] = Field(description="By rising sieve")
    correlated: CorrelatedCurve | None = Field(
        default=None, description="Null without a correlation study of the product"
    )
    quantiles: list[Quantile] = Field(description="Sizes D10 to D90, or those of the product or the request")
    indices: ShapeIndices = Field(description="Fineness, uniformity, mean sizes and shape")
    flakiness_decision: Decision | None = Field(description="Verdict on FI (EN 933-3); null without limits")
    shape_decision: Decision | None = Field(description="Verdict on SI (EN 933-4); null without limits")
    countdown: str | None = Field(description="What is decided and what is not, in words")
    uncertainty: list[UncertaintyBudget] = Field(
        default=[], description="Budgets of D50, FI and SI, as far as they were measured"
    )
    unmeasured: Unmeasured = Field(description="What fell and is in no figure")
    least_portion_kg: float | None = Field(description="Least test portion of EN 933-1 for D; null without D")
    scale_sd_percent: float = Field(description="Standard deviation of all lengths, by the calibration")
    calibration_ids: list[str] = Field(description="Calibrations that the stones were measured with")
    algorithm_versions: list[str] = Field(description="Versions of the algorithms that measured them")
    without: list[str] = Field(
        default=[],
        description="Ids of stones that were left out because the request asked so: figures as if they had not fallen."
        " Nothing of it is stored",
    )
    algorithm_version: str | None = Field(
        default=None,
        description="Version by which alone stones were taken, because the request asked so; null: each stone in its"
        " newest revision",
    )
    is_simulated: bool = Field(description="True when images of some stones are synthetic")
    is_replay: bool = Field(description="True when some stones did not fall")

    @property
    def correlated_percent(self) -> dict[float, float | None]:
        """Passing by sieve as the laboratory's sieves would find it; empty without a correlation study."""
        return (
            {step.sieve_mm: step.passing_percent.value for step in self.correlated.curve}
            if self.correlated
            else {}
        )

    @property
    def correlation_version(self) -> str | None:
        """Version of the correlation study, None without one."""
        return str(self.correlated.version) if self.correlated else None


SHARES: Mapping[str, Callable[[MeasuredRange], Property]] = {
    "flakiness_percent": is_flaky,
    "shape_percent": is_non_cubical,
}
"""Indices that are followed over time and compared: each a share of the stones, by the property that it counts."""


def decision_on(figures: LotFigures, index: str) -> Decision | None:
    """Return the verdict on one of `INDICES`, None without limits."""
    found = {"flakiness_percent": figures.flakiness_decision, "shape_percent": figures.shape_decision}
    return found.get(index)


def shares_of(forms: Iterable[FlatAndElongated]) -> Iterator[tuple[int, str, str, Estimate]]:
    """Yield the shares of ASTM D4791: ratio, name in `FlatAndElongated`, basis that was counted by, figure."""
    for form in forms:
        for name in DIMENSIONS:
            for counted, figure in getattr(form, name).items():
                yield form.ratio, name, counted, figure


def named_figures(figures: LotFigures) -> dict[str, Estimate]:
    """Return curve, sizes and indices, with the sieve or the share in their name and the unit at its end."""
    return {
        **{f"passing_{step.sieve_mm:g}_mm_percent": step.passing_percent for step in figures.curve},
        **{f"d{each.percent:g}_mm": each.exact_mm for each in figures.quantiles},
        **{name: getattr(figures.indices, name) for name in INDICES},
    }
