"""`stonefall report`: offline results as a report."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from support.lot_figures import report_data
from typer.testing import CliRunner, Result

from service.base.errors import ServiceError, UsageError
from service.commands.cli import build_app
from service.reports.printed import render_pdf
from service.reports.signatures import instrument_key, signed
from service.results.fields import EMPTY, RUSH

STONE = {
    "outcome": "measured", "kind": "particle", "quality": "good", "captured_at": "2026-03-01T10:00:00Z",
    "volume_mm3": 900.0, "sieve_size_mm": 11.0, "max_feret_mm": 16.0, "min_feret_mm": 9.0, "length_mm": 16.0,
    "width_mm": 12.0, "thickness_mm": 9.0, "volume_sd_percent": 1.0, "surface_sd_mm": 0.02, "is_simulated": True,
}  # fmt: skip


def results(folder: Path, records: list[dict[str, Any]]) -> Path:
    folder.mkdir()
    (folder / "results.jsonl").write_text("".join(json.dumps({**EMPTY, **each}) + "\n" for each in records))
    return folder


def report(*words: str | Path) -> Result:
    return CliRunner().invoke(build_app(["report"]), ["report", *map(str, words)])


def test_results_become_a_report_in_every_format(tmp_path: Path) -> None:
    ball = {**STONE, "kind": "ball", "volume_mm3": 1e6}
    lost = {"kind": "particle", "outcome": "lost", "reason": "no_frames"}
    rushed = {**STONE, "body": "estimate", "refinement_fallback": RUSH}
    folder = results(tmp_path / "out", [{**STONE, "body": "photo"}] * 59 + [rushed, ball, lost])
    words = ("--lower-mm", "8", "--upper-mm", "16", "--specification", "GC85-20", "--language", "de")
    done = report(folder, "--out", tmp_path / "report", *words)
    assert done.exit_code == 0, done.output
    assert "report of 60 stones" in done.output
    assert {path.name for path in (tmp_path / "report").iterdir()} == {
        "report.html", "report.pdf", "report.csv", "report.xlsx",
    }  # fmt: skip
    table = (tmp_path / "report/report.csv").read_text()
    assert "no_frames" in table
    assert "accounting,body: photo,,59,stones" in table
    assert "accounting,not_refined: rush,,1,stones" in table
    assert "GC85-20 8/16" in table


@pytest.mark.parametrize(
    ("words", "error", "named"),
    [
        (("--specification", "GC99"), UsageError, "GC99"),
        (("--specification", "GC85-20"), UsageError, "lower_mm"),
        (("--sieves", "none"), UsageError, "sieve_set"),
    ],
)
def test_what_cannot_be_judged_is_named(
    tmp_path: Path, words: tuple[str, ...], error: type[ServiceError], named: str
) -> None:
    done = report(results(tmp_path / "out", [STONE]), "--out", tmp_path / "report", *words)
    assert isinstance(done.exception, error)
    assert named in str(done.exception)
    assert not (tmp_path / "report").exists()


@pytest.mark.parametrize("line", ["{", "[1]", "null"])
def test_damaged_results_are_named_by_their_line(tmp_path: Path, line: str) -> None:
    folder = results(tmp_path / "out", [STONE])
    with (folder / "results.jsonl").open("a") as file:
        file.write(line + "\n")
    done = report(folder, "--out", tmp_path / "report")
    assert isinstance(done.exception, ServiceError)
    assert "line 2" in str(done.exception)


def test_a_signed_report_is_checked_without_a_daemon(tmp_path: Path) -> None:
    key = instrument_key(tmp_path)
    said = {"instrument": "SF-1", "lot": "L1", "revision": 1, "signed_at": "2026-11-20T07:00:03Z"}
    file = tmp_path / "L1-1.pdf"
    file.write_bytes(signed(render_pdf(report_data()), key, **said))
    answer = tmp_path / "key.json"
    answer.write_text(json.dumps({"public_key": key.public_key, "fingerprint": key.fingerprint}))
    for known in (key.fingerprint, key.fingerprint.replace("-", " ").upper(), key.public_key, answer):
        done = report("--verify", file, "--key", known)
        assert done.exit_code == 0, done.output
        assert (
            "genuine: report of lot L1, revision 1, 2026-11-20T07:00:03Z, signed by instrument SF-1"
            in done.output
        )
        assert key.fingerprint in done.output


def test_what_is_wrong_with_a_signed_report_is_named(tmp_path: Path) -> None:
    key = instrument_key(tmp_path)
    said = {"instrument": None, "lot": "L1", "revision": 1, "signed_at": "2026-11-20T07:00:03Z"}
    pdf = render_pdf(report_data())
    good = signed(pdf, key, **said)
    other = "-".join(["0000"] * 8)
    for content, words, error, named in (
        (good, (), ServiceError, f"intact.*signed as an instrument with key {key.fingerprint}: compare it"),
        (good, ("--key", other), ServiceError, f"signed by another key, {key.fingerprint}, not by {other}"),
        (good[:-1], ("--key", key.fingerprint), ServiceError, "was changed after it was signed"),
        (good.replace(b"endobj", b"endobk", 1), ("--key", key.fingerprint), ServiceError, "was changed"),
        (pdf, ("--key", key.fingerprint), ServiceError, "carries no signature"),
        (b"", ("--key", key.fingerprint), ServiceError, "is no PDF"),
        (good, ("--key", "3f1c"), UsageError, "--key 3f1c"),
    ):
        file = tmp_path / "report.pdf"
        file.write_bytes(content)
        done = report("--verify", file, *words)
        assert (done.exit_code, type(done.exception)) == (1, error)
        assert re.search(named, str(done.exception)), done.exception
    assert "No such file" in str(report("--verify", tmp_path / "none.pdf").exception)
    assert isinstance(report().exception, UsageError)
