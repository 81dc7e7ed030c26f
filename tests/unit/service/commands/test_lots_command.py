"""`stonefall lots` prints what a daemon answers."""

import pytest
from support.lot_figures import lot_figures
from typer.testing import CliRunner

from service.cli import build_app
from service.commands import lots


def test_a_lot_says_what_fell_and_which_bodies_were_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lots, "ask", lambda *_: lot_figures().model_dump(mode="json"))
    done = CliRunner().invoke(build_app(["lots"]), ["lots", "show", "2026-04711"])
    assert done.exit_code == 0, done.output
    assert "1012 stones fell = 987 measured + 21 rejected + 4 lost" in done.output
    assert "body: 901 photo, 84 estimate, 2 hull" in done.output
    assert "not refined: 71 rush, 13 no evidence" in done.output
    monkeypatch.setattr(
        lots, "ask", lambda *_: lot_figures(by_body={}, not_refined={}).model_dump(mode="json")
    )
    assert "body" not in CliRunner().invoke(build_app(["lots"]), ["lots", "show", "2026-04711"]).output
