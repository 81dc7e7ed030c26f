"""The figures of a report as rows for machines: one figure a row, names as in REST, full precision."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from pipeline.gradation.estimates import Estimate
from service.lots.figures import Decision, FlatAndElongated
from service.reports.report import ReportData, Scalar


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A text or a number of a report; what does not apply is None, and so is what was not measured."""

    section: str
    name: str
    sieve_mm: float | None = None
    value: Scalar = None
    unit: str | None = None
    figure: Estimate | None = None  # with interval and errors; its value is `value`
    decision: Decision | None = None


def rows(data: ReportData) -> Iterator[Row]:
    """Yield all rows of a report but those of single stones."""
    yield from lot_rows(data)
    yield from curve_rows(data)
    yield from index_rows(data)
    for sieving in data.sievings:
        for name, text in (
            ("id", sieving.id),
            ("at", sieving.at),
            ("by", sieving.by),
            ("study", sieving.correlation),
        ):
            yield Row(section="laboratory", name=name, value=text)
        for step in sieving.steps:
            passing = {"passing_percent": step.passing_percent, "correlated_percent": step.correlated_percent}
            for name, percent in passing.items():
                yield Row(section="laboratory", name=name, sieve_mm=step.sieve_mm, value=percent, unit="%")
    yield from accounting_rows(data)
    yield from about_rows(data)


def lot_rows(data: ReportData) -> Iterator[Row]:
    """Yield the lot, its product and its verdict."""
    figures = data.figures
    for name, value in figures.lot.model_dump(mode="json").items() if figures.lot else ():
        yield Row(section="lot", name=name, value=value)
    for name, value in figures.product.model_dump(mode="json").items() if figures.product else ():
        yield Row(section="product", name=name, value=value)
    for name in ("sieve_set", "specification", "specification_source", "since", "until"):
        yield Row(section="lot", name=name, value=getattr(figures, name))
    yield Row(
        section="verdict", name="verdict", value=None if figures.verdict is None else str(figures.verdict)
    )
    yield Row(section="verdict", name="is_partial", value=figures.is_partial)
    yield Row(section="verdict", name="countdown", value=figures.countdown)


def curve_rows(data: ReportData) -> Iterator[Row]:
    """Yield the curve by mass and by number, then the quantiles."""
    for step in data.figures.curve:
        sieve_mm, by_number = step.sieve_mm, step.passing_by_number_percent
        yield _figure_row("curve", "passing_percent", step.passing_percent, "%", step.decision, sieve_mm)
        yield _figure_row("curve", "passing_by_number_percent", by_number, "%", sieve_mm=sieve_mm)
    for quantile in data.figures.quantiles:
        yield _figure_row("quantiles", f"d{quantile.percent}_interpolated_mm", quantile.interpolated_mm, "mm")
        yield _figure_row("quantiles", f"d{quantile.percent}_exact_mm", quantile.exact_mm, "mm")


def index_rows(data: ReportData) -> Iterator[Row]:
    """Yield the figures of the whole lot."""
    figures = data.figures
    decisions: Mapping[str, Decision | None] = {
        "flakiness_percent": figures.flakiness_decision,
        "shape_percent": figures.shape_decision,
    }
    for name, value in figures.indices:
        if isinstance(value, Estimate):
            unit = "%" if name.endswith("_percent") else "mm" if name.endswith("_mm") else None
            yield _figure_row("indices", name, value, unit, decisions.get(name))
    found = figures.indices
    yield from _form_rows("d4791", found.flat_and_elongated)
    for part in found.flat_and_elongated_fractions:
        section = f"d4791 {part.lower_mm:g} to {part.upper_mm:g} mm"
        yield Row(section=section, name="mass_percent", value=part.mass_percent, unit="%")
        yield Row(section=section, name="n_stones", value=part.n_stones, unit="stones")
        yield from _form_rows(section, part.forms)
    yield from _form_rows("d4791 mean by mass", found.flat_and_elongated_weighted)


def _form_rows(section: str, forms: Iterable[FlatAndElongated]) -> Iterator[Row]:
    for form in forms:
        for name, by in form:
            if isinstance(by, Mapping):
                for counted, figure in by.items():
                    yield _figure_row(section, f"1:{form.ratio} {name} by {counted}", figure, "%")


def accounting_rows(data: ReportData) -> Iterator[Row]:
    """Yield the accounting: outcomes, bodies, and the mass that was not measured."""
    figures = data.figures
    for name in ("triggers", "measured", "rejected", "lost"):
        yield Row(section="accounting", name=name, value=getattr(figures, name), unit="stones")
    for quality, n in figures.by_quality.items():
        yield Row(section="accounting", name=f"measured: {quality}", value=n, unit="stones")
    for body, n in figures.by_body.items():
        yield Row(section="accounting", name=f"body: {body}", value=n, unit="stones")
    for why, n in figures.not_refined.items():
        yield Row(section="accounting", name=f"not_refined: {why}", value=n, unit="stones")
    for reason, n in figures.unmeasured.by_reason.items():
        yield Row(section="accounting", name=reason, value=n, unit="stones")
    missing = figures.unmeasured
    yield Row(
        section="accounting", name="unmeasured_expected_percent", value=missing.expected_percent, unit="%"
    )
    yield Row(
        section="accounting", name="unmeasured_at_most_percent", value=missing.at_most_percent, unit="%"
    )
    yield Row(section="accounting", name="n_effective", value=figures.n_effective)
    yield Row(section="accounting", name="mass_kg", value=figures.mass_kg, unit="kg")
    yield Row(section="accounting", name="least_portion_kg", value=figures.least_portion_kg, unit="kg")


def about_rows(data: ReportData) -> Iterator[Row]:
    """Yield calibration, verification and versions behind the figures."""
    figures, last = data.figures, data.verification
    known: Mapping[str, Scalar] = {
        "is_simulated": figures.is_simulated,
        "is_replay": figures.is_replay,
        "calibration_ids": ", ".join(figures.calibration_ids),
        "scale_sd_percent": figures.scale_sd_percent,
        "verification_id": None if last is None else last.id,
        "verification_at": None if last is None else last.at,
        "verification_outcome": None if last is None else str(last.outcome),
        "verification_diameter_mm": None if last is None else last.diameter_mm,
        "verification_error_mm": None if last is None else last.error_mm,
        "is_verification_overdue": data.is_verification_overdue,
        "uncertainty_remark": data.uncertainty_remark,
        "algorithm_versions": ", ".join(figures.algorithm_versions),
        "software_version": data.software_version,
        "api_version": data.api_version,
        "created_at": data.created_at,
    }
    for name, value in known.items():
        yield Row(section="about", name=name, value=value)


def _figure_row(
    section: str,
    name: str,
    figure: Estimate,
    unit: str | None,
    decision: Decision | None = None,
    sieve_mm: float | None = None,
) -> Row:
    return Row(
        section=section,
        name=name,
        sieve_mm=sieve_mm,
        value=figure.value,
        unit=unit,
        figure=figure,
        decision=decision,
    )
