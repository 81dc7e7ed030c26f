"""`stonefall lots` prints what a daemon answers."""

from typing import Any

import pytest
from support.lot_figures import decision, lot_figures
from typer.testing import CliRunner

from pipeline.gradation.specification import Verdict
from service.commands.cli import build_app
from service.commands.daemon_client import DaemonClient
from service.commands.lots import why_open


def test_a_lot_says_what_fell_and_which_bodies_were_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(DaemonClient, "ask", lambda *_: lot_figures().model_dump(mode="json"))
    done = CliRunner().invoke(build_app(["lots"]), ["lots", "show", "2026-04711"])
    assert done.exit_code == 0, done.output
    assert "1012 stones fell = 987 measured + 21 rejected + 4 lost" in done.output
    assert "body: 901 photo, 84 estimate, 2 hull" in done.output
    assert "not refined: 71 rush, 13 no evidence" in done.output
    monkeypatch.setattr(
        DaemonClient, "ask", lambda *_: lot_figures(by_body={}, not_refined={}).model_dump(mode="json")
    )
    assert "body" not in CliRunner().invoke(build_app(["lots"]), ["lots", "show", "2026-04711"]).output


def figures_of_one_sieve(verdict: Verdict, more_stones: int | None, **fields: Any) -> dict[str, Any]:
    """Return the figures of a lot of 13 stones of which one sieve and the shape index have limits."""
    step = lot_figures().curve[5].model_copy(update={"sieve_mm": 16.0})
    curve = [step.model_copy(update={"decision": decision(verdict, 85, 99, more_stones)})]
    given = {"measured": 13, "verdict": verdict, "curve": curve, "flakiness_decision": None}
    shape = decision(Verdict.CONFORMS, 0, 20)
    return lot_figures(**given | {"shape_decision": shape} | fields).model_dump(mode="json")


def test_an_open_verdict_says_why_and_what_would_close_it() -> None:
    assert why_open(figures_of_one_sieve(Verdict.INSUFFICIENT, 381)) == (
        "open, as 13 stones are too few for a verdict; about 381 more would close it, if the curve stays"
        " (16 mm takes the most)"
    )
    assert why_open(
        figures_of_one_sieve(Verdict.UNDECIDED, 40, shape_decision=decision(Verdict.UNDECIDED, 0, 20, 99))
    ) == (
        "open, as with 13 stones the 95 % interval reaches over a limit; about 99 more would close it, if the"
        " curve stays (SI takes the most)"
    )
    never = why_open(figures_of_one_sieve(Verdict.UNDECIDED, None))
    assert never is not None and never.endswith("no number of stones would decide 16 mm")


@pytest.mark.parametrize("verdict", [Verdict.CONFORMS, Verdict.DOES_NOT_CONFORM, Verdict.NOT_MEASURED])
def test_a_decided_verdict_is_not_called_open(verdict: Verdict) -> None:
    assert why_open(figures_of_one_sieve(verdict, None)) is None
