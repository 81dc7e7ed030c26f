"""`stonefall lots` prints what a daemon answers."""

from pathlib import Path
from typing import Any

import pytest
from support.lot_figures import decision, lot_figures
from typer.testing import CliRunner

from pipeline.gradation.specification import Verdict
from service.base.errors import UsageError
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


def test_control_charts_are_a_table_with_what_is_out_of_control(monkeypatch: pytest.MonkeyPatch) -> None:
    in_control = {"lot": "L1", "is_counted": True, "figure": {"value": 11.2}, "rules": []}
    limits = {"lower": 10.5, "upper": 12.0, "ewma": 11.3}
    out = {**in_control, **limits, "lot": "L2", "figure": {"value": 12.4}, "rules": ["beyond_limits", "ewma"]}
    d50 = {"figure": "d50_mm", "centre": 11.25, "capability": None, "points": [in_control, out]}
    few = {"figure": "shape_percent", "centre": None, "capability": None, "points": []}
    answer = {"charts": [d50, few], "drifting": [{"figure": "d50_mm"}]}
    monkeypatch.setattr(DaemonClient, "ask", lambda *_: answer)
    done = CliRunner().invoke(build_app(["lots"]), ["lots", "control", "basalt-8-16"])
    assert done.exit_code == 0, done.output
    rows = [" ".join(line.split()) for line in done.output.splitlines()]
    assert "│ d50_mm │ 2 │ 12.40 │ 10.50 │ 11.25 │ 12.00 │ 11.30 │ - │ - │" in rows
    assert "d50_mm: lot L2: beyond_limits, ewma" in done.output
    assert "drifting: d50_mm" in done.output


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        ("a.csv", "/lots/L%201/stones.csv?language=de"),
        ("a.parquet", "/lots/L%201/stones.parquet?"),
        ("a.xlsx", None),
    ],
)
def test_the_stones_of_a_lot_are_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str, asked: str | None
) -> None:
    addresses: list[str] = []
    monkeypatch.setattr(DaemonClient, "fetch", lambda _, path, **__: addresses.append(path) or b"content")
    given = ["lots", "stones", "L 1", "--out", str(tmp_path / name), "--language", "de"]
    done = CliRunner().invoke(build_app(["lots"]), given)
    assert addresses == ([] if asked is None else [asked])
    if asked is None:
        assert isinstance(done.exception, UsageError)
        assert "must end with .csv, .parquet" in str(done.exception)
    else:
        assert (done.exit_code, (tmp_path / name).read_bytes()) == (0, b"content")
