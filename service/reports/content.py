"""Contents of a report, section by section, in the words of a language."""

from collections.abc import Iterator, Mapping, Sequence

from pipeline.gradation.specification import Decision, Verdict
from pipeline.gradation.stones import Fate
from service.lots.figures import LotFigures
from service.lots.lots import LotDocument, LotState
from service.reports.budget import budget
from service.reports.document import (
    DASH,
    Block,
    Card,
    Cards,
    Document,
    Note,
    Section,
    facts,
)
from service.reports.letterhead import letterhead, signature
from service.reports.report import EndedVerification, GalleryStone, ReportData, VerificationOutcome
from service.reports.results import gradation, indices, judged_indices, laboratory, limits, with_interval
from service.reports.words import LONGEST_HEADING, Words, abridged, words

MOST_CARDS = 8
FAMILIES: Mapping[str, tuple[str, str]] = {
    Fate.MEASURED: ("outcome", "quality"),
    Fate.REJECTED: ("outcome", "reason"),
    Fate.LOST: ("outcome", "reason"),
}
"""Sections of the words for the two parts of an entry of the accounting; of others `accounting` and the first part."""


def document_of(data: ReportData) -> Document:
    """Return the report as HTML and PDF print it."""
    say, figures = words(data.language, data.plant.zone), data.figures
    name = abridged(figures.lot.lot, LONGEST_HEADING) if figures.lot else say("report.no_lot")
    sections = (
        lot_section(data, say),
        gradation(data, say),
        indices(data, say),
        *(laboratory(sieving, data, say) for sieving in data.sievings),
        accounting(figures, say),
        calibration(data, say),
        uncertainty(data, say),
        *((gallery(data.gallery, say),) if data.gallery else ()),
        signature(data, say),
    )
    return Document(
        language=data.language,
        letterhead=letterhead(
            data.plant, data.logo_svg, f"/lots/{figures.lot.lot}/report" if figures.lot else None, say
        ),
        title=say("report.title", name=name),
        subtitle=_subtitle(data, say),
        banners=tuple(banners(data, say)),
        verdict=None if _is_void(figures.lot) else figures.verdict,
        verdict_title=_verdict_title(data, say),
        verdict_lines=tuple(countdown(data, say)),
        sections=sections,
        footer=say("report.footer", name=name, at=say.time(data.created_at)),
        page=say("report.page"),
        created_at=data.created_at,
    )


def banners(data: ReportData, say: Words) -> Iterator[str]:
    """Yield the reasons why this is no report of production, or none that counts."""
    lot = data.figures.lot
    if data.figures.is_simulated:
        yield say("banner.simulated")
    if data.figures.is_replay:
        yield say("banner.replay")
    if lot is not None and lot.state is LotState.VOID:
        yield say("banner.void", reason=abridged(lot.void_reason or DASH))
    if lot is not None and lot.state is LotState.OPEN:
        yield say("banner.open")
    if lot is not None and lot.state is LotState.CLOSING:
        yield say("banner.closing")


def _is_void(lot: LotDocument | None) -> bool:
    return lot is not None and lot.state is LotState.VOID


def _subtitle(data: ReportData, say: Words) -> str:
    product = data.figures.product
    parts = (product and abridged(product.title, LONGEST_HEADING), data.figures.specification)
    return " · ".join(abridged(part, LONGEST_HEADING) for part in parts if part) or say("report.subtitle")


def _verdict_title(data: ReportData, say: Words) -> str:
    figures = data.figures
    if _is_void(figures.lot):
        return say("verdict_box.void")
    if figures.verdict is None:
        return say("verdict_box.none")
    word = say.known("verdict", figures.verdict)
    title = word[:1].upper() + word[1:]
    return say("verdict_box.partial", verdict=title) if figures.is_partial else title


def countdown(data: ReportData, say: Words) -> Iterator[str]:
    """Yield the figures that keep the lot from conforming, with the stones and time that would decide each."""
    figures = data.figures
    named = [
        (say("verdict_box.sieve", sieve=say.size(step.sieve_mm)), step.passing_percent, step.decision)
        for step in figures.curve
    ]
    named += [(title, figure, decision) for _, title, figure, decision in judged_indices(figures, say)]
    judged = [(name, decision, figure) for name, figure, decision in named if decision is not None]
    for name, decision, figure in judged:
        if figure.value is None:
            yield say("verdict_box.unmeasured_line", name=name, limits=limits(decision, say))
        elif decision.verdict is not Verdict.CONFORMS:
            yield say(
                "verdict_box.line",
                name=name,
                verdict=say.known("verdict", decision.verdict),
                figure=with_interval(figure, 1, say),
                limits=limits(decision, say),
            ) + (_more(decision, say) if figures.lot is None or figures.lot.state is LotState.OPEN else "")
        if decision.asks_declaration:
            yield say("verdict_box.declare", name=name, limits=limits(decision, say))
    if judged and all(decision.verdict is Verdict.CONFORMS for _, decision, _ in judged):
        yield say("verdict_box.all_conform", n=say.number(len(judged), 0))


def _more(decision: Decision, say: Words) -> str:
    if decision.more_stones is None:
        return ""
    n = say.number(decision.more_stones, 0)
    if decision.more_s is None:
        return say("verdict_box.more_stones", n=n)
    return say("verdict_box.more_stones_and_time", n=n, time=duration(decision.more_s, say))


def duration(seconds: float, say: Words) -> str:
    """Return a time that is expected, in the unit in which a person thinks of it."""
    if seconds < 120:
        return say("duration.seconds", value=say.number(seconds, 0))
    if seconds < 7200:
        return say("duration.minutes", value=say.number(seconds / 60, 0))
    return say("duration.hours", value=say.number(seconds / 3600, 1))


def lot_section(data: ReportData, say: Words) -> Section:
    """Return the section on the lot, in ISA-95 terms."""
    figures, lot, product = data.figures, data.figures.lot, data.figures.product
    values: dict[str, str | None] = {}
    if lot is not None:
        values = {"lot": lot.lot, "sublot": lot.sublot, "state": say.known("lot_state", lot.state)}
    if product is not None:
        version = say("lot.product_version", product=product.product, version=product.version)
        density = say("lot.kg_m3", value=say.number(product.density_kg_m3, 0))
        values |= {"product": f"{product.title} ({version})", "density": density}
    values |= {
        "specification": figures.specification,
        "specification_source": figures.specification_source,
        "sieve_set": figures.sieve_set,
    }
    if lot is not None:
        values |= {
            **{name: getattr(lot, name) for name in ("customer", "order", "external_id", "equipment")},
            "sample_id": lot.sample_id,
            "sampler": lot.sampler,
            "tonnage": None
            if lot.tonnage_t is None
            else say("lot.tonnes", value=say.number(lot.tonnage_t, 1)),
            "opened": say.time(lot.opened_at),
            "closed": say.time(lot.closed_at) if lot.closed_at else say("lot.not_closed"),
            "revision": str(lot.revision) if lot.revision > 1 else None,
        }
    if figures.since and figures.until:
        values["stones_fell"] = f"{say.time(figures.since)} – {say.time(figures.until)}"
    if lot is not None:
        values["remark"] = lot.remark
    printed = {name: value and abridged(value) for name, value in values.items()}
    return Section(say("lot.title"), (facts(say, "lot", **printed),))


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
        missing=", ".join(
            f"{accounted(reason, say)} {say.number(n, 0)}" for reason, n in missing.by_reason.items()
        ),
    )
    n_missing = say.number(missing.n_stones, 0)
    if not missing.n_stones:
        return Section(say("accounting.title"), (block, Note(say("accounting.nothing_missing"))))
    bound = say("accounting.bound_unknown", n=n_missing)
    if missing.expected_percent is not None and missing.at_most_percent is not None:
        expected, at_most = (
            say.number(percent, 1) for percent in (missing.expected_percent, missing.at_most_percent)
        )
        bound = say("accounting.bound", n=n_missing, expected=expected, at_most=at_most)
    return Section(say("accounting.title"), (block, Note(bound)))


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
    """Return the section on the evidence: calibrations, the last verification, versions."""
    figures, last = data.figures, data.verification
    blocks: list[Block] = [
        facts(
            say,
            "calibration",
            ids=abridged(", ".join(figures.calibration_ids) or say("calibration.none")),
            scale=say("calibration.percent", value=say.number(figures.scale_sd_percent, 3)),
            last=say("calibration.never") if last is None else _verification(last, say),
            software=say(
                "calibration.versions",
                software=abridged(data.software_version),
                api=abridged(data.api_version),
                algorithm=abridged(", ".join(figures.algorithm_versions) or DASH),
            ),
        )
    ]
    if data.is_verification_overdue:
        blocks.append(Note(say("calibration.overdue"), is_warning=True))
    if last is not None and last.outcome is VerificationOutcome.FAILED:
        blocks.append(Note(say("calibration.failed"), is_warning=True))
    return Section(say("calibration.title"), blocks)


def _verification(last: EndedVerification, say: Words) -> str:
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
    if figures.specification_is_general:
        notes.append(Note(say("uncertainty.general", source=abridged(figures.specification_source or DASH))))
    if data.uncertainty_remark:
        notes.append(Note(abridged(data.uncertainty_remark, 2000)))
    return Section(say("uncertainty.title"), (*notes, *budget(figures, say)))


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
    return Section(say("gallery.title"), (), (Cards(cards),))
