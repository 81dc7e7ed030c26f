"""Contents of a report, section by section, in the words of a language."""

from collections.abc import Iterator

from pipeline.gradation.specification import Decision, Verdict
from service.lots.lots import LotDocument, LotState
from service.reports.document import DASH, Document, Section, Signatures, facts
from service.reports.evidence import accounting, calibration, gallery, uncertainty, versions
from service.reports.report import ReportData
from service.reports.results import gradation, indices, judged_indices, laboratory, limits, with_interval
from service.reports.texts import LONGEST_HEADING, abridged
from service.reports.words import Words, words


def document_of(data: ReportData) -> Document:
    """Return the report as HTML and PDF print it."""
    say, figures = words(data.language), data.figures
    name = abridged(figures.lot.lot, LONGEST_HEADING) if figures.lot else say("report.no_lot")
    signed = (say("signature.tested_by"), say("signature.released_by"))
    sections = (
        lot_section(data, say),
        gradation(data, say),
        indices(data, say),
        *(laboratory(sieving, data, say) for sieving in data.sievings),
        accounting(figures, say),
        calibration(data, say),
        uncertainty(data, say),
        *((gallery(data.gallery, say),) if data.gallery else ()),
        versions(data, say),
        Section(say("signature.title"), (Signatures(signed),)),
    )
    return Document(
        language=data.language,
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
            ) + _more(decision, say)
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
            "equipment": lot.equipment,
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
