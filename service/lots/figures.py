"""The figures of a lot as REST returns them and the report prints them."""

from collections.abc import Mapping

from pydantic import Field

from pipeline.gradation.estimates import Estimate, State
from pipeline.gradation.specification import Verdict
from service.lots.lots import LotState
from service.results.fields import TIME
from service.status import Report


class Figure(Report):
    """A figure with its uncertainty, in the unit of its name."""

    state: State = Field(description="`insufficient`: too few stones for a verdict; `not_measured`: no value")
    value: float | None = None
    low: float | None = Field(default=None, description="Lower end of the 95 % interval")
    high: float | None = Field(default=None, description="Upper end of it")
    standard_error: float | None = Field(default=None, description="Of sampling and measuring together")
    sampling_se: float | None = Field(default=None, description="Other stones might have fallen")
    measuring_se: float | None = Field(default=None, description="Random errors of each stone")
    systematic_se: float | None = Field(default=None, description="Errors that all stones share")
    n_effective: float = Field(default=0.0, description="So many stones of equal mass would tell as much")


class Range(Report):
    """Limits of a specification, percent."""

    min_percent: float
    max_percent: float


class Decision(Report):
    """The verdict on one figure."""

    verdict: Verdict
    limits: Range
    more_stones: int | None = Field(
        default=None, description="Stones until it is expected to be decided; null: decided, or never"
    )
    more_s: float | None = Field(default=None, description="Seconds that these take at the present rate")


class CurveStep(Report):
    """The gradation at one sieve."""

    sieve_mm: float
    passing_percent: Figure = Field(description="By mass")
    passing_by_number_percent: Figure
    decision: Decision | None = Field(description="Null where the specification has no limits")


class CorrelatedStep(Report):
    """The gradation at one sieve, as the laboratory's sieves would find it."""

    sieve_mm: float
    passing_percent: Figure


class CorrelatedCurve(Report):
    """The curve by the product's correlation study, beside the raw one."""

    version: int = Field(description="Of the study")
    factor: float = Field(description="Sieve's size by the instrument's")
    n_lots: int
    held_out_rmse: float | None = Field(description="Points of passing, on lots that it was not fitted to")
    curve: list[CorrelatedStep]


class Quantile(Report):
    """A size that a share of the mass is smaller than; the two are different figures, and never mixed."""

    percent: int
    interpolated_mm: Figure = Field(description="Log-linear between neighbouring sieves")
    exact_mm: Figure = Field(description="From the stones themselves")


class FlatAndElongated(Report):
    """ASTM D4791 at one ratio, percent: by mass and by number."""

    ratio: int
    flat_percent: Mapping[str, Figure] = Field(description="Method A: width to thickness above the ratio")
    elongated_percent: Mapping[str, Figure] = Field(description="Method A: length to width above it")
    flat_and_elongated_percent: Mapping[str, Figure] = Field(
        description="Method B: length to thickness above it"
    )


class ShapeIndices(Report):
    """Figures of the whole lot beside its curve."""

    fineness_modulus: Figure = Field(description="ASTM C136")
    uniformity: Figure = Field(description="Cu = D60 / D10")
    curvature: Figure = Field(description="Cc = D30² / (D10 D60)")
    d32_mm: Figure = Field(description="ISO 9276-2, mean by surface, of the sieve size")
    d43_mm: Figure = Field(description="ISO 9276-2, mean by volume, of the sieve size")
    flakiness_percent: Figure = Field(description="FI, EN 933-3")
    shape_percent: Figure = Field(description="SI, EN 933-4")
    needle_flaky_percent: Figure = Field(description="JTG 3432 T 0312")
    flat_and_elongated: list[FlatAndElongated]


class Unmeasured(Report):
    """Stones that fell and are in no figure, and what they may have weighed."""

    n_stones: int
    by_reason: Mapping[str, int] = Field(description="By outcome and reason, such as `rejected: clipped`")
    expected_percent: float | None = Field(
        description="Of the measured mass, if each was as heavy as the mean"
    )
    at_most_percent: float | None = Field(
        description="The same if each was as heavy as the heaviest, or as a sphere that fills the view"
    )


class ProductDocument(Report):
    """The version of a product that a lot is of."""

    product: str
    version: int
    title: str
    density_kg_m3: float
    specification: str | None


class LotDocument(Report):
    """A lot in the words of ISA-95."""

    lot: str
    state: LotState
    product: str = Field(description="Material definition")
    product_version: int
    equipment: str | None
    sublot: str | None
    sample_id: str | None
    sampler: str | None
    tonnage_t: float | None
    remark: str | None
    opened_at: str = Field(json_schema_extra=TIME)
    closed_at: str | None = Field(json_schema_extra=TIME)
    void_reason: str | None
    n_stones: int = Field(description="Stones that fell, whatever became of them")


class LotFigures(Report):
    """All figures of the stones of a lot, or of a time."""

    lot: LotDocument | None = Field(description="Null for a window, a shift, and results without a store")
    product: ProductDocument | None
    since: str | None = Field(description="First stone, RFC 3339 UTC", json_schema_extra=TIME)
    until: str | None = Field(description="Last stone", json_schema_extra=TIME)
    triggers: int = Field(description="measured + rejected + lost")
    measured: int
    rejected: int
    lost: int
    by_quality: Mapping[str, int] = Field(description="Measured stones by quality")
    mass_kg: float | None = Field(description="Of the measured stones; null without a density")
    n_effective: float = Field(description="So many stones of equal mass would tell as much")
    sieve_set: str
    specification: str | None
    specification_source: str | None
    curve: list[CurveStep] = Field(description="By rising sieve")
    correlated: CorrelatedCurve | None = Field(
        default=None, description="Null without a correlation study of the product"
    )
    quantiles: list[Quantile]
    indices: ShapeIndices
    flakiness_decision: Decision | None
    shape_decision: Decision | None
    verdict: Verdict | None = Field(description="Null without a specification")
    is_partial: bool = Field(description="True when some figures of the specification were not measured")
    countdown: str | None = Field(description="What is decided and what is not, in words")
    unmeasured: Unmeasured
    least_portion_kg: float | None = Field(description="Least test portion of EN 933-1 for D; null without D")
    scale_sd_percent: float = Field(description="Standard deviation of all lengths, by the calibration")
    calibration_ids: list[str]
    algorithm_versions: list[str]
    is_simulated: bool
    is_replay: bool


def figure(estimate: Estimate) -> Figure:
    """Return an estimate as it is served."""
    return Figure(
        state=estimate.state,
        value=estimate.value,
        low=estimate.low,
        high=estimate.high,
        standard_error=estimate.standard_error,
        sampling_se=estimate.sampling_se,
        measuring_se=estimate.measuring_se,
        systematic_se=estimate.systematic_se,
        n_effective=estimate.n_effective,
    )
