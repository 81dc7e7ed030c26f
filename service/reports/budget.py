"""The uncertainty statement of a report: expanded uncertainties in a sentence, and the budget behind them."""

from service.base.units import unit_of
from service.lots.figures import LotFigures
from service.reports.document import Block, Column, Note, Table
from service.reports.words import Words

DECIMALS = {"d50_mm": 3}
"""Digits after the point, one more than the figure has; others have two."""
COLUMNS = ("value", "sampling", "instrument", "scale", "combined", "expanded")


def budget(figures: LotFigures, say: Words) -> tuple[Block, ...]:
    """Return the statement and its budget (JCGM 100:2008, 7.2.3), nothing while no figure has one."""
    found = figures.uncertainty
    if not found:
        return ()
    named = [
        say(
            "budget.figure",
            name=say.known("budget_of", each.figure),
            value=say.number(each.value, decimals := DECIMALS.get(each.figure, 2) - 1),
            expanded=say.number(each.expanded, decimals),
            unit=unit_of(each.figure),
        )
        for each in found
    ]
    k, scale = say.number(found[0].coverage_factor, 0), say.number(figures.scale_sd_percent, 3)
    table = Table(
        (
            Column(say("budget.of"), is_number=False, width=0.8),
            *(Column(say(f"budget.{name}")) for name in COLUMNS),
        ),
        [
            (
                f"{say.known('budget_of', each.figure)}, {unit_of(each.figure)}",
                *(say.number(getattr(each, name), DECIMALS.get(each.figure, 2)) for name in COLUMNS),
            )
            for each in found
        ],
    )
    return (Note(say("budget.statement", figures=", ".join(named), k=k, scale=scale)), table)
