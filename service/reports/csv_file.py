"""The report as one CSV table (RFC 4180) in the words of REST: one figure a row, the same in every language."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from pipeline.gradation.d4791 import FlatAndElongated
from pipeline.gradation.estimates import Estimate
from pipeline.gradation.indices import INDICES
from pipeline.gradation.specification import Decision
from service.base.csv_text import RFC_4180, CsvStyle, csv_text
from service.base.units import unit_of
from service.lots.figures import LotFigures, decision_on, shares_of
from service.reports.report import ReportData, Scalar
from service.reports.words import plain

UNCERTAINTY = (
    "low_95",
    "high_95",
    "standard_error",
    "sampling_se",
    "measuring_se",
    "systematic_se",
    "n_effective",
)
DECIDED = ("limit_min", "limit_max", "verdict", "more_stones", "more_s")
COLUMNS = ("section", "name", "sieve_mm", "value", "unit", *UNCERTAINTY, "state", *DECIDED)


@dataclass(frozen=True, slots=True)
class Row:
    """A text or a number of a report; what does not apply is None, and so is what was not measured."""

    section: str
    name: str
    value: Scalar = None
    unit: str | None = None
    sieve_mm: float | None = None
    figure: Estimate | None = None  # with interval and errors; its value is `value`
    decision: Decision | None = None


def render_csv(data: ReportData, style: CsvStyle = RFC_4180) -> bytes:
    """Return the report as CSV: UTF-8, commas and decimal points unless of another style, empty without a value."""
    rows = ([_cell(value) for value in _values(row)] for row in _rows(data))
    return csv_text([COLUMNS, *rows], style).encode("utf-8", "replace")


def _cell(value: Scalar) -> Scalar:
    if isinstance(value, bool):
        return "true" if value else "false"
    return plain(value) if isinstance(value, str) else value


def _values(row: Row) -> tuple[Scalar, ...]:
    figure, decision = row.figure, row.decision
    uncertainty: list[Scalar] = [None] * len(UNCERTAINTY)
    if figure is not None and figure.value is not None:
        uncertainty = [getattr(figure, name.removesuffix("_95")) for name in UNCERTAINTY]
    decided: tuple[Scalar, ...] = (None,) * len(DECIDED)
    if decision is not None:
        low, high = decision.limits.min_percent, decision.limits.max_percent
        decided = (low, high, decision.verdict, decision.more_stones, decision.more_s)
    state = None if figure is None else figure.state
    return (row.section, row.name, row.sieve_mm, row.value, row.unit, *uncertainty, state, *decided)


def _rows(data: ReportData) -> Iterator[Row]:
    """Yield all rows of a report but those of single stones."""
    yield from _lot_rows(data.figures)
    yield from _curve_rows(data.figures)
    yield from _index_rows(data.figures)
    for budget in data.figures.uncertainty:
        for name in ("sampling", "instrument", "scale", "combined", "coverage_factor", "expanded"):
            unit = None if name == "coverage_factor" else unit_of(budget.figure)
            yield Row("uncertainty", f"{budget.figure} {name}", getattr(budget, name), unit)
    yield from _laboratory_rows(data)
    yield from accounting_rows(data.figures)
    yield from _about_rows(data)


def _named(section: str, values: Mapping[str, Scalar], unit: str | None = None) -> Iterator[Row]:
    return (Row(section, name, value, unit) for name, value in values.items())


def _lot_rows(figures: LotFigures) -> Iterator[Row]:
    """Yield the lot, its product and its verdict."""
    for section, part in (("lot", figures.lot), ("product", figures.product)):
        if part is not None:
            yield from _named(section, part.model_dump(mode="json"))
    for section, names in (
        ("lot", ("sieve_set", "specification", "specification_source", "since", "until")),
        ("verdict", ("verdict", "is_partial", "countdown")),
    ):
        yield from _named(section, {name: getattr(figures, name) for name in names})


def _curve_rows(figures: LotFigures) -> Iterator[Row]:
    """Yield the curve by mass and by number, then the quantiles."""
    for step in figures.curve:
        yield _figure_row("curve", "passing_percent", step.passing_percent, step.decision, step.sieve_mm)
        by_number = step.passing_by_number_percent
        yield _figure_row("curve", "passing_by_number_percent", by_number, sieve_mm=step.sieve_mm)
    for quantile in figures.quantiles:
        yield _figure_row("quantiles", f"d{quantile.percent:g}_interpolated_mm", quantile.interpolated_mm)
        yield _figure_row("quantiles", f"d{quantile.percent:g}_exact_mm", quantile.exact_mm)


def _index_rows(figures: LotFigures) -> Iterator[Row]:
    """Yield the figures of the whole lot."""
    found = figures.indices
    for name in INDICES:
        yield _figure_row("indices", name, getattr(found, name), decision_on(figures, name))
    yield from _form_rows("d4791", found.flat_and_elongated)
    for part in found.flat_and_elongated_fractions:
        section = f"d4791 {part.lower_mm:g} to {part.upper_mm:g} mm"
        yield Row(section, "mass_percent", part.mass_percent, "%")
        yield Row(section, "n_stones", part.n_stones, "stones")
        yield from _form_rows(section, part.forms)
    yield from _form_rows("d4791 mean by mass", found.flat_and_elongated_weighted)


def _form_rows(section: str, forms: Iterable[FlatAndElongated]) -> Iterator[Row]:
    for ratio, name, counted, figure in shares_of(forms):
        yield Row(section, f"1:{ratio} {name} by {counted}", figure.value, "%", figure=figure)


def _figure_row(
    section: str, name: str, figure: Estimate, decision: Decision | None = None, sieve_mm: float | None = None
) -> Row:
    return Row(section, name, figure.value, unit_of(name), sieve_mm, figure, decision)


def _laboratory_rows(data: ReportData) -> Iterator[Row]:
    correlated, version = data.figures.correlated_percent, data.figures.correlation_version
    for sieving in data.sievings:
        given = {name: getattr(sieving.document, name) for name in ("sample_id", "remark")}
        about = {"id": str(sieving.sieving), "at": sieving.at, "by": sieving.document.by, "study": version}
        about |= {name: text for name, text in given.items() if text}
        yield from _named("laboratory", about)
        for sieve_mm, percent in sieving.document.passing_percent.items():
            yield Row("laboratory", "passing_percent", percent, "%", sieve_mm)
            yield Row("laboratory", "correlated_percent", correlated.get(sieve_mm), "%", sieve_mm)


def accounting_rows(figures: LotFigures) -> Iterator[Row]:
    """Yield the accounting: outcomes, bodies, and the mass that was not measured."""
    counts = {name: getattr(figures, name) for name in ("triggers", "measured", "rejected", "lost")}
    counts |= {f"measured: {quality}": n for quality, n in figures.by_quality.items()}
    counts |= {f"body: {body}": n for body, n in figures.by_body.items()}
    counts |= {f"not_refined: {why}": n for why, n in figures.not_refined.items()}
    missing = figures.unmeasured
    yield from _named("accounting", counts | dict(missing.by_reason), "stones")
    for name, value in (
        ("unmeasured_expected_percent", missing.expected_percent),
        ("unmeasured_at_most_percent", missing.at_most_percent),
        ("n_effective", figures.n_effective),
        ("mass_kg", figures.mass_kg),
        ("least_portion_kg", figures.least_portion_kg),
    ):
        yield Row("accounting", name, value, unit_of(name))


def _about_rows(data: ReportData) -> Iterator[Row]:
    """Yield plant, calibration, verification and versions behind the figures."""
    yield from _named("plant", data.plant.texts)
    figures, last = data.figures, data.verification
    verification = ("id", "at", "outcome", "diameter_mm", "error_mm")
    known: Mapping[str, Scalar] = {
        "is_simulated": figures.is_simulated,
        "is_replay": figures.is_replay,
        "calibration_ids": ", ".join(figures.calibration_ids),
        "scale_sd_percent": figures.scale_sd_percent,
        **{f"verification_{name}": None if last is None else getattr(last, name) for name in verification},
        "is_verification_overdue": data.is_verification_overdue,
        "uncertainty_remark": data.uncertainty_remark,
        "specification_is_general": figures.specification_is_general,
        "algorithm_versions": ", ".join(figures.algorithm_versions),
        "software_version": data.software_version,
        "api_version": data.api_version,
        "created_at": data.created_at,
    }
    yield from _named("about", known)
