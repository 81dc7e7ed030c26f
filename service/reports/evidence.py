"""Evidence of a report: accounting, calibration, uncertainty, pictures, versions."""

from collections.abc import Iterator, Sequence

from service.lots.figures import LotFigures
from service.reports.document import DASH, Card, Cards, Column, NamesAndValues, Note, Section, Table
from service.reports.report import GalleryStone, LastVerification, ReportData
from service.reports.texts import LONGEST_HEADING, abridged
from service.reports.words import Words

MOST_CARDS = 8


def accounting(figures: LotFigures, say: Words) -> Section:
    """Return the section on the outcome of every stone that fell, and on the mass missing in the curve."""
    missing = figures.unmeasured
    by_quality = ", ".join(
        f"{say.known('quality', quality)} {say.number(n, 0)}" for quality, n in figures.by_quality.items()
    )
    measured = (
        f"{say.number(figures.measured, 0)} ({abridged(by_quality)})"
        if by_quality
        else say.number(figures.measured, 0)
    )
    facts = NamesAndValues(
        (
            (say("accounting.triggers"), say.number(figures.triggers, 0)),
            (say("accounting.measured"), measured),
            *_bodies(figures, say),
            (say("accounting.rejected"), say.number(figures.rejected, 0)),
            (say("accounting.lost"), say.number(figures.lost, 0)),
            (say("accounting.n_effective"), say.number(figures.n_effective, 0)),
            (say("accounting.mass"), _mass(figures.mass_kg, say)),
            (say("accounting.portion"), portion(figures, say)),
        )
    )
    if not missing.n_stones:
        return Section(say("accounting.title"), (facts, Note(say("accounting.nothing_missing"))))
    table = Table(
        (Column(say("accounting.reason"), is_number=False, width=4), Column(say("accounting.stones"))),
        [(_reason(reason, say), say.number(n, 0)) for reason, n in missing.by_reason.items()],
    )
    unknown = missing.expected_percent is None or missing.at_most_percent is None
    bound = (
        say("accounting.bound_unknown", n=say.number(missing.n_stones, 0))
        if unknown
        else say(
            "accounting.bound",
            n=say.number(missing.n_stones, 0),
            expected=say.number(missing.expected_percent, 1),
            at_most=say.number(missing.at_most_percent, 1),
        )
    )
    return Section(say("accounting.title"), (facts, Note(say("accounting.missing")), table, Note(bound)))


def _bodies(figures: LotFigures, say: Words) -> Iterator[tuple[str, str]]:
    """Yield the counts of estimated and refined bodies, and the reasons why some were only estimated."""
    n_known = sum(figures.by_body.values())
    shares = (
        say(
            "accounting.share",
            name=say.known("body", body),
            n=say.number(n, 0),
            percent=say.number(100 * n / n_known, 1),
        )
        for body, n in figures.by_body.items()
    )
    whys = (f"{say.known('not_refined', why)} {say.number(n, 0)}" for why, n in figures.not_refined.items())
    if figures.by_body:
        yield say("accounting.body"), ", ".join(shares)
    if figures.not_refined:
        yield say("accounting.not_refined"), ", ".join(whys)


def _mass(mass_kg: float | None, say: Words) -> str:
    return (
        say("accounting.no_mass") if mass_kg is None else say("accounting.kg", value=say.number(mass_kg, 2))
    )


def _reason(text: str, say: Words) -> str:
    """Return `rejected: clipped` in the language of the report."""
    outcome, separator, reason = text.partition(": ")
    if not separator:
        return abridged(text)
    return f"{say.known('outcome', outcome)}: {say.known('reason', reason)}"


def portion(figures: LotFigures, say: Words) -> str:
    """Return the sentence on the test portion of EN 933-1: reached, not reached or unknown."""
    least_kg, mass_kg = figures.least_portion_kg, figures.mass_kg
    if least_kg is None:
        return say("accounting.portion_unknown")
    if mass_kg is None:
        return say("accounting.portion_without_mass", least=say.number(least_kg, 2))
    key = "accounting.portion_reached" if mass_kg >= least_kg else "accounting.portion_not_reached"
    # rounded down: 99.7 % is not 100 %
    percent = int(100 * mass_kg / least_kg) if least_kg > 0 else 100
    return say(
        key, mass=say.number(mass_kg, 2), least=say.number(least_kg, 2), percent=say.number(percent, 0)
    )


def calibration(data: ReportData, say: Words) -> Section:
    """Return the section on the calibrations of the results and the last verification."""
    figures, last = data.figures, data.verification
    ids = ", ".join(figures.calibration_ids) or say("calibration.none")
    facts = NamesAndValues(
        (
            (say("calibration.ids"), abridged(ids)),
            (
                say("calibration.scale"),
                say("calibration.percent", value=say.number(figures.scale_sd_percent, 3)),
            ),
            (say("calibration.last"), say("calibration.never") if last is None else _verification(last, say)),
        )
    )
    warnings = []
    if last is None or data.is_verification_overdue:
        warnings.append(Note(say("calibration.overdue"), is_warning=True))
    if last is not None and last.outcome == "failed":
        warnings.append(Note(say("calibration.failed"), is_warning=True))
    return Section(say("calibration.title"), (facts, *warnings))


def _verification(last: LastVerification, say: Words) -> str:
    outcome, at = say.known("verification", last.outcome), say.time(last.at)
    diameter = say.number(last.diameter_mm, 2)
    if last.error_mm is None:
        return say(
            "calibration.verified_without_error",
            outcome=outcome,
            at=at,
            diameter=diameter,
            id=abridged(last.id),
        )
    error = ("+" if last.error_mm > 0 else "") + say.number(last.error_mm, 3)
    return say(
        "calibration.verified", outcome=outcome, at=at, diameter=diameter, id=abridged(last.id), error=error
    )


def uncertainty(data: ReportData, say: Words) -> Section:
    """Return the section on what the confidence intervals include and exclude."""
    figures = data.figures
    notes = [
        Note(
            say(
                "uncertainty.intervals",
                n=say.number(figures.measured, 0),
                n_effective=say.number(figures.n_effective, 0),
                scale=say.number(figures.scale_sd_percent, 3),
            )
        ),
        Note(say("uncertainty.limits")),
    ]
    if data.uncertainty_remark:
        notes.append(Note(abridged(data.uncertainty_remark, 2000)))
    return Section(say("uncertainty.title"), notes)


def gallery(stones: Sequence[GalleryStone], say: Words) -> Section:
    """Return the stones that matter most for the figures."""
    cards = [
        Card(
            title=", ".join(say.known("gallery_reason", reason) for reason in stone.reasons),
            lines=(
                abridged(stone.id, LONGEST_HEADING),
                say("gallery.size", sieve=say.number(stone.sieve_size_mm, 2)),
                say("gallery.volume", volume=say.number(stone.volume_mm3, 0)),
                say("gallery.quality", quality=say.known("quality", stone.quality)),
            ),
            png=stone.preview_png,
            missing=say("gallery.no_picture"),
        )
        for stone in stones[:MOST_CARDS]
    ]
    return Section(say("gallery.title"), (Cards(cards),))


def versions(data: ReportData, say: Words) -> Section:
    """Return the section on the versions of software, algorithm and interface."""
    algorithms = ", ".join(data.figures.algorithm_versions) or DASH
    return Section(
        say("versions.title"),
        (
            NamesAndValues(
                (
                    (say("versions.software"), abridged(data.software_version)),
                    (say("versions.algorithm"), abridged(algorithms)),
                    (say("versions.api"), abridged(data.api_version)),
                    (say("versions.created"), say.time(data.created_at)),
                )
            ),
        ),
    )
