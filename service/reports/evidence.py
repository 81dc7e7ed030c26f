"""Evidence of a report: accounting, calibration, uncertainty, pictures, versions."""

from collections.abc import Mapping, Sequence

from pipeline.gradation.stones import Fate
from service.lots.figures import LotFigures
from service.reports.document import DASH, Block, Card, Cards, Column, Note, Section, Table, facts
from service.reports.report import GalleryStone, LastVerification, ReportData, VerificationOutcome
from service.reports.texts import LONGEST_HEADING, abridged
from service.reports.words import Words

MOST_CARDS = 8
FAMILIES: Mapping[str, tuple[str, str]] = {
    Fate.MEASURED: ("outcome", "quality"),
    Fate.REJECTED: ("outcome", "reason"),
    Fate.LOST: ("outcome", "reason"),
}
"""Sections of the words for the two parts of an entry of the accounting; of others `accounting` and the first part."""


def accounting(figures: LotFigures, say: Words) -> Section:
    """Return the section on the outcome of every stone that fell, and on the mass missing in the curve."""
    missing, mass_kg, by_body = figures.unmeasured, figures.mass_kg, figures.by_body
    measured = say.number(figures.measured, 0)
    if figures.by_quality:
        measured += f" ({abridged(_counts('quality', figures.by_quality, say))})"
    n_known = sum(by_body.values())
    shares = (
        say("accounting.share", name=say.known("body", body), n=say.number(n, 0), percent=percent)
        for body, n in by_body.items()
        for percent in (say.number(100 * n / n_known, 1),)
    )
    block = facts(
        say,
        "accounting",
        triggers=say.number(figures.triggers, 0),
        measured=measured,
        body=", ".join(shares),
        not_refined=_counts("not_refined", figures.not_refined, say),
        rejected=say.number(figures.rejected, 0),
        lost=say.number(figures.lost, 0),
        n_effective=say.number(figures.n_effective, 0),
        mass=say("accounting.no_mass")
        if mass_kg is None
        else say("accounting.kg", value=say.number(mass_kg, 2)),
        portion=portion(figures, say),
    )
    n_missing = say.number(missing.n_stones, 0)
    if not missing.n_stones:
        return Section(say("accounting.title"), (block, Note(say("accounting.nothing_missing"))))
    table = Table(
        (Column(say("accounting.reason"), is_number=False, width=4), Column(say("accounting.stones"))),
        [(accounted(reason, say), say.number(n, 0)) for reason, n in missing.by_reason.items()],
    )
    bound = say("accounting.bound_unknown", n=n_missing)
    if missing.expected_percent is not None and missing.at_most_percent is not None:
        expected, at_most = (
            say.number(percent, 1) for percent in (missing.expected_percent, missing.at_most_percent)
        )
        bound = say("accounting.bound", n=n_missing, expected=expected, at_most=at_most)
    return Section(say("accounting.title"), (block, Note(say("accounting.missing")), table, Note(bound)))


def _counts(family: str, counts: Mapping[str, int], say: Words) -> str:
    return ", ".join(f"{say.known(family, word)} {say.number(n, 0)}" for word, n in counts.items())


def accounted(name: str, say: Words) -> str:
    """Return an entry of the accounting in the words of a language: `rejected: clipped`, `body: photo`, `mass_kg`."""
    group, separator, word = name.partition(": ")
    if not separator:
        return say.known("accounting", name)
    heading, family = FAMILIES.get(group, ("accounting", group))
    return f"{say.known(heading, group)}: {say.known(family, word)}"


def portion(figures: LotFigures, say: Words) -> str:
    """Return the sentence on the test portion of EN 933-1: reached, not reached or unknown."""
    least_kg, mass_kg = figures.least_portion_kg, figures.mass_kg
    if least_kg is None:
        return say("accounting.portion_unknown")
    least = say.number(least_kg, 2)
    if mass_kg is None:
        return say("accounting.portion_without_mass", least=least)
    key = "accounting.portion_reached" if mass_kg >= least_kg else "accounting.portion_not_reached"
    # rounded down: 99.7 % is not 100 %
    percent = int(100 * mass_kg / least_kg) if least_kg > 0 else 100
    return say(key, mass=say.number(mass_kg, 2), least=least, percent=say.number(percent, 0))


def calibration(data: ReportData, say: Words) -> Section:
    """Return the section on the calibrations of the results and the last verification."""
    figures, last = data.figures, data.verification
    blocks: list[Block] = [
        facts(
            say,
            "calibration",
            ids=abridged(", ".join(figures.calibration_ids) or say("calibration.none")),
            scale=say("calibration.percent", value=say.number(figures.scale_sd_percent, 3)),
            last=say("calibration.never") if last is None else _verification(last, say),
        )
    ]
    if last is None or data.is_verification_overdue:
        blocks.append(Note(say("calibration.overdue"), is_warning=True))
    if last is not None and last.outcome is VerificationOutcome.FAILED:
        blocks.append(Note(say("calibration.failed"), is_warning=True))
    return Section(say("calibration.title"), blocks)


def _verification(last: LastVerification, say: Words) -> str:
    key, error = "calibration.verified_without_error", ""
    if last.error_mm is not None:
        key, error = "calibration.verified", ("+" if last.error_mm > 0 else "") + say.number(last.error_mm, 3)
    return say(
        key,
        outcome=say.known("verification", last.outcome),
        at=say.time(last.at),
        diameter=say.number(last.diameter_mm, 2),
        id=abridged(last.id),
        error=error,
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
    block = facts(
        say,
        "versions",
        software=abridged(data.software_version),
        algorithm=abridged(", ".join(data.figures.algorithm_versions) or DASH),
        api=abridged(data.api_version),
        created=say.time(data.created_at),
    )
    return Section(say("versions.title"), (block,))
