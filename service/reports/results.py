"""The figures of a lot as tables: gradation, indices, and the laboratory's beside the instrument's."""

from pipeline.gradation.estimates import Estimate, State
from pipeline.gradation.indices import ShapeIndices
from pipeline.gradation.specification import Decision
from service.lots.figures import LotFigures, decision_on
from service.lots.laboratory import StoredSieving
from service.reports.curve import gradation_curve
from service.reports.document import DASH, Block, Column, Note, Picture, Section, Table
from service.reports.report import ReportData
from service.reports.words import LONGEST_HEADING, Words, abridged


def limits(decision: Decision | None, say: Words) -> str:
    """Return the limits of a specification."""
    if decision is None:
        return DASH
    low, high = decision.limits.min_percent, decision.limits.max_percent
    texts = [f"{value:.4g}".replace(".", say("number.decimal_mark")) for value in (low, high)]
    return texts[0] if low == high else " – ".join(texts)


def with_interval(figure: Estimate | None, decimals: int, say: Words) -> str:
    """Return a figure with its 95 % interval in brackets."""
    if figure is None or figure.value is None:
        return say("state.not_measured")
    value = say.number(figure.value, decimals)
    return value if figure.low is None else f"{value} ({say.interval(figure, decimals)})"


def gradation(data: ReportData, say: Words) -> Section:
    """Return the curve and its table."""
    figures = data.figures
    laboratory_passing = data.sievings[-1].document.passing_percent if data.sievings else None
    columns = (
        Column(say("curve.sieve"), width=0.95),
        Column(say("curve.passing"), width=1.3),
        Column(say("curve.interval"), width=1.3),
        Column(say("curve.by_number"), width=1.3),
        Column(say("curve.limits"), width=1.1),
        Column(say("curve.verdict"), is_number=False, width=1.5),
    )
    steps = sorted(figures.curve, key=lambda step: -step.sieve_mm)
    rows = [
        (
            say.size(step.sieve_mm),
            say.number(step.passing_percent.value, 1),
            say.interval(step.passing_percent, 1),
            say.number(step.passing_by_number_percent.value, 1),
            limits(step.decision, say),
            verdict_word(step.decision, step.passing_percent, say),
        )
        for step in steps
    ]
    table = Table(columns, rows, [step.decision.verdict if step.decision else None for step in steps])
    return Section(
        say("curve.title"),
        (
            Picture(gradation_curve(figures.curve, say, laboratory_passing)),
            table,
            Note(say("curve.note")),
            Note(say("quantiles.note")),
            _quantiles(figures, say),
        ),
    )


def _quantiles(figures: LotFigures, say: Words) -> Table:
    """Return the sizes that a share of the mass passes."""
    return Table(
        (
            Column(say("quantiles.size"), is_number=False, width=0.7),
            Column(say("quantiles.interpolated")),
            Column(say("curve.interval"), width=1.3),
            Column(say("quantiles.exact")),
            Column(say("curve.interval"), width=1.3),
        ),
        [
            (
                f"D{say.size(quantile.percent)}",
                *(
                    text
                    for figure in (quantile.interpolated_mm, quantile.exact_mm)
                    for text in (say.number(figure.value, 2), say.interval(figure, 2))
                ),
            )
            for quantile in figures.quantiles
        ],
    )


def verdict_word(decision: Decision | None, figure: Estimate, say: Words) -> str:
    """Return the verdict on a figure; without limits what kept it from being measured, if anything did."""
    if decision is not None:
        return say.known("verdict", decision.verdict)
    return "" if figure.state is State.MEASURED else say.known("state", figure.state)


def judged_indices(figures: LotFigures, say: Words) -> list[tuple[str, str, Estimate, Decision | None]]:
    """Return name, title, figure and verdict of each index of the lot, in the order of the words."""
    return [
        (name, say(f"index.{name}"), getattr(figures.indices, name), decision_on(figures, name))
        for name in say.family("index")
    ]


def indices(data: ReportData, say: Words) -> Section:
    """Return the figures of the whole lot, each with the standard that defines it."""
    found, listed = data.figures.indices, judged_indices(data.figures, say)
    table = Table(
        (
            Column(say("indices.index"), is_number=False, width=4.75),
            Column(say("indices.value"), width=1.45),
            Column(say("curve.interval"), width=1.35),
            Column(say("curve.limits"), width=1.1),
            Column(say("curve.verdict"), is_number=False, width=1.65),
        ),
        [
            (
                title,
                say.number(figure.value, decimals := int(say(f"decimals.{name}"))),
                say.interval(figure, decimals),
                limits(decision, say),
                verdict_word(decision, figure, say),
            )
            for name, title, figure, decision in listed
        ],
        [decision.verdict if decision else None for *_, decision in listed],
    )
    if not found.flat_and_elongated:
        return Section(say("indices.title"), (table,))
    by_mass, by_number = (_forms(found, by, say) for by in ("mass", "number"))
    on_screen = (by_number, *_size_fractions(found, say))
    return Section(say("indices.title"), (table, Note(say("d4791.note")), by_mass), on_screen)


def _forms(found: ShapeIndices, by: str, say: Words) -> Table:
    """Return the shares of ASTM D4791 by mass or by number."""
    return Table(
        (
            Column(say("d4791.ratio"), is_number=False, width=0.85),
            Column(say("d4791.counted"), is_number=False, width=0.9),
            Column(say("d4791.flat_percent"), width=1.4),
            Column(say("d4791.elongated_percent"), width=1.4),
            Column(say("d4791.flat_and_elongated_percent"), width=1.5),
        ),
        [
            (
                f"1:{form.ratio}",
                say.known("counted", by),
                with_interval(form.flat_percent[by], 1, say),
                with_interval(form.elongated_percent.get(by), 1, say),
                with_interval(form.flat_and_elongated_percent.get(by), 1, say),
            )
            for form in found.flat_and_elongated
            if by in form.flat_percent
        ],
    )


def _size_fractions(found: ShapeIndices, say: Words) -> tuple[Block, ...]:
    """Return ASTM D4791 size by size, the flat and elongated ones alone: the other files have all forms."""
    fractions = found.flat_and_elongated_fractions
    if not fractions:
        return ()
    weighted = found.flat_and_elongated_weighted
    mass_percent = sum(part.mass_percent for part in fractions)
    parts = [
        *(
            (
                say("d4791.between", lower=say.size(part.lower_mm), upper=say.size(part.upper_mm)),
                part.mass_percent,
                part.n_stones,
                part.forms,
            )
            for part in fractions
        ),
        (say("d4791.weighted"), mass_percent, sum(part.n_stones for part in fractions), weighted),
    ]
    table = Table(
        (
            Column(say("d4791.fraction"), is_number=False, width=1.2),
            Column(say("d4791.share"), width=0.8),
            Column(say("d4791.stones"), width=0.7),
            Column(say("d4791.counted"), is_number=False, width=0.9),
            *(Column(f"1:{form.ratio}") for form in weighted),
        ),
        [
            (
                name,
                say.number(mass_percent, 1),
                str(n_stones),
                say.known("counted", by),
                *(with_interval(form.flat_and_elongated_percent[by], 0, say) for form in forms),
            )
            for name, mass_percent, n_stones, forms in parts
            for by in forms[0].flat_and_elongated_percent
        ],
    )
    return (Note(say("d4791.fractions_note")), table)


def laboratory(sieving: StoredSieving, data: ReportData, say: Words) -> Section:
    """Return a sieving of the laboratory beside the raw and the correlated passing of the instrument."""
    raw = {step.sieve_mm: step.passing_percent.value for step in data.figures.curve}
    correlated, study = data.figures.correlated_percent, data.figures.correlation_version
    titles = (
        "curve.sieve",
        "laboratory.raw",
        "laboratory.correlated",
        "laboratory.sieved",
        "laboratory.difference",
    )
    passing = sorted(sieving.document.passing_percent.items(), reverse=True)
    rows = [
        (
            say.size(sieve_mm),
            say.number(value := raw.get(sieve_mm), 1),
            DASH if (mapped := correlated.get(sieve_mm)) is None else say.number(mapped, 1),
            say.number(percent, 1),
            DASH if value is None else say.number(value - percent, 1),
        )
        for sieve_mm, percent in passing
    ]
    by = abridged(sieving.document.by or DASH, LONGEST_HEADING)
    about = say("laboratory.about", id=sieving.sieving, at=say.time(sieving.at), by=by)
    if sieving.document.sample_id:
        about += say("laboratory.sample", sample=abridged(sieving.document.sample_id, LONGEST_HEADING))
    remark = sieving.document.remark
    remarks = (Note(say("laboratory.remark", remark=abridged(remark))),) if remark else ()
    rests_on = say("laboratory.study", study=study) if study else say("laboratory.no_study")
    table = Table([Column(say(title)) for title in titles], rows)
    return Section(say("laboratory.title"), (Note(about + "."), *remarks, table, Note(rests_on)))
