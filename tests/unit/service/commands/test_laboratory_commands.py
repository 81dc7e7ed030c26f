"""`stonefall lots sieving`, `sievings`, `correlations` ask a daemon for what their options say, and print answers."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from service.commands.cli import build_app
from service.commands.daemon_client import DaemonClient
from service.lots.routes.laboratory import HistoryRequest, SievingRequest, StudyRequest, WithdrawRequest
from service.lots.routes.lots import VoidRequest

STORED = {
    "sieving": 3,
    "at": "2026-03-01T06:00:00.000Z",
    "by": "Ann",
    "mass_g": 1000.0,
    "passing_percent": {"8": 12.0, "16": 90.0},
    "voided_at": None,
    "void_reason": None,
    "replaced_by": None,
}
VOIDED = {**STORED, "voided_at": "2026-03-02T06:00:00.000Z", "void_reason": "a slip", "replaced_by": 4}
READ = {
    "lot": "L1",
    "understood": "column 1: aperture in mm; column 2: passing in %",
    "mass_g": None,
    "sieves": [
        {
            "sieve_mm": 8.0,
            "retained_g": None,
            "passing_percent": 12.0,
            "instrument_percent": {"value": 40.25},
            "difference": 28.25,
        }
    ],
    "implausible": "lot L1: at 8 mm",
}
STUDY = {
    "version": 2,
    "state": "draft",
    "is_in_use": False,
    "factor": 0.97,
    "n_lots": 1,
    "raw_rmse": 2.5,
    "held_out_rmse": None,
    "obstacles": ["it rests on 1 lots, fewer than 5"],
}

Run = Callable[..., tuple[Result, list[tuple[str, Any]]]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Run:
    """Return a function that runs a command with the daemon's answer, and returns what the daemon was asked."""

    def invoke(answer: dict[str, Any], *words: str) -> tuple[Result, list[tuple[str, Any]]]:
        asked: list[tuple[str, Any]] = []

        def ask(
            _: DaemonClient, path: str, body: dict[str, Any] | None = None, **more: Any
        ) -> dict[str, Any]:
            given = body and {name: value for name, value in body.items() if value is not None}
            asked.append((path, given))
            return answer

        monkeypatch.setattr(DaemonClient, "ask", ask)
        return CliRunner().invoke(build_app(["lots"]), ["lots", *words]), asked

    return invoke


def test_a_file_is_sent_as_its_table(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "sheet.csv"
    file.write_text("Sieb mm;Rückstand g\n8;3", encoding="utf-8")
    done, asked = run(
        STORED, "sieving", "L1", str(file), "--dry-mass-g", "1001", "--replaces", "2", "--reason", "slip"
    )
    assert done.exit_code == 0, done.output
    assert "sieving 3 of lot L1 is stored: 2 sieves, 1000 g" in done.output
    ((path, body),) = asked
    assert path == "/lots/L1/sieving"
    wanted = SievingRequest(**body)
    assert (wanted.table, wanted.dry_mass_g, wanted.replaces) == (file.read_text(encoding="utf-8"), 1001.0, 2)
    assert (wanted.reason, wanted.dry_run) == ("slip", False)


def test_a_dry_run_shows_the_table_as_it_was_read(run: Run, tmp_path: Path) -> None:
    (tmp_path / "sheet.csv").write_text("8;3")
    done, asked = run(READ, "sieving", "L1", str(tmp_path / "sheet.csv"), "--dry-run")
    assert done.exit_code == 0, done.output
    assert SievingRequest(**asked[0][1]).dry_run
    assert "read as: column 1: aperture in mm; column 2: passing in %" in done.output
    assert "40.2" in done.output
    assert "implausible: lot L1: at 8 mm" in done.output


def test_sievings_are_listed_and_voided(run: Run) -> None:
    listed, asked = run({"items": [STORED, VOIDED]}, "sieving", "L1")
    assert asked == [("/lots/L1/sieving", None)]
    assert "a slip (see 4)" in " ".join(listed.output.split())
    done, asked = run(VOIDED, "sieving", "L1", "--void", "3", "--reason", "a slip")
    assert asked == [("/lots/L1/sieving/3/void", VoidRequest(reason="a slip").model_dump())]
    assert "sieving 3 of lot L1 is void" in done.output
    refused, asked = run(VOIDED, "sieving", "L1", "--void", "3")
    assert (refused.exit_code != 0, asked) == (True, [])


def test_a_history_is_one_request(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "months.csv"
    file.write_text("Los;Sieb mm;g\nL1;8;3")
    done, asked = run({"items": [{**STORED, "lot": "L1"}]}, "sievings", str(file), "--reason", "old")
    assert done.exit_code == 0, done.output
    assert "sieving 3 of lot L1 is stored" in done.output
    ((path, body),) = asked
    assert path == "/sievings"
    assert HistoryRequest(**body).reason == "old"
    printed, _ = run({"items": []}, "sievings", str(file), "--json")
    assert json.loads(printed.output) == {"items": []}


def test_studies_are_made_accepted_and_withdrawn(run: Run) -> None:
    path = "/products/basalt/correlations"
    listed, asked = run({"items": [STUDY]}, "correlations", "basalt")
    assert asked == [(path, None)]
    assert "version 2 cannot be accepted: it rests on 1 lots" in listed.output
    _, asked = run(STUDY, "correlations", "basalt", "--study", "--form", "monotone")
    assert StudyRequest(**asked[0][1]).form == "monotone"
    _, asked = run(STUDY, "correlations", "basalt", "--accept", "2")
    assert asked[0][0] == f"{path}/2/accept"
    _, asked = run(STUDY, "correlations", "basalt", "--withdraw", "2", "--reason", "new screens")
    assert asked == [(f"{path}/2/withdraw", WithdrawRequest(reason="new screens").model_dump())]
    for words in (["--withdraw", "2"], ["--study", "--accept", "2"]):
        refused, asked = run(STUDY, "correlations", "basalt", *words)
        assert (refused.exit_code != 0, asked) == (True, [])
