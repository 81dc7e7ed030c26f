"""`stonefall calibration` against a fake daemon: its requests, and what it prints of the answers."""

import json
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from service.commands import calibration
from service.commands.cli import build_app

COVERAGE = {
    "missing": "3 more drops",
    "extent_mm": [10.0, 9.0, 8.0],
    "cameras": {"c01": {"n_drops": 2, "field_share": 0.25}},
}
REPORT = {
    "scale": "ball_diameter",
    "held_out_px": 0.05,
    "drops_used": ["a", "b"],
    "residuals_after_px": {"c01": 0.031},
    "uncertainty": {"length_sd_percent": 0.01},
    "problems": [{"camera": "c02", "detail": "it was moved: fasten it"}],
}


def details(state: str, n_drops: int = 0, *, report: dict[str, Any] | None = None) -> dict[str, Any]:
    drops = [
        {
            "bundle": f"{number}",
            "views": ["c01"],
            "center_mm": [1.0, 2.0, 3.0],
            "residuals_px": {"c01": 12.3},
            "problem": None,
        }
        for number in range(n_drops)
    ]
    return {
        "id": "0002",
        "state": state,
        "is_active": False,
        "method": "bundle",
        "detail": None,
        "drops": drops,
        "coverage": COVERAGE,
        "residuals_before_px": {"c01": 12.3},
        "report": report,
    }


@dataclass
class Pretender:
    """Answers requests in turn; a status other than 200 is a problem."""

    answers: list[tuple[int, dict[str, Any]]] = field(default_factory=list)
    asked: list[tuple[str, str, str | None, Any]] = field(default_factory=list)
    url: str = ""

    def run(self, *words: str) -> Result:
        return CliRunner().invoke(
            build_app(["calibration"]), ["calibration", *words, "--url", self.url], env={"COLUMNS": "120"}
        )


@pytest.fixture
def daemon(monkeypatch: pytest.MonkeyPatch) -> Iterator[Pretender]:
    monkeypatch.setattr(calibration, "FOLLOW_S", 0.0)
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")  # which is not asked for a daemon of this machine
    pretender = Pretender()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self._answer(None)

        def do_POST(self) -> None:
            self._answer(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))

        def _answer(self, body: Any) -> None:
            pretender.asked.append((self.command, self.path, self.headers["Authorization"], body))
            status, document = pretender.answers.pop(0)
            content = json.dumps(document).encode()
            self.send_response(status)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    pretender.url = f"http://127.0.0.1:{server.server_port}"
    yield pretender
    server.shutdown()
    thread.join()
    server.server_close()


def test_drops_are_shown_as_they_fall(daemon: Pretender):
    daemon.answers = [
        (201, details("collecting")),
        (200, {"state": "armed"}),
        (200, details("collecting", 1)),
        (200, details("collecting", 2)),
        (200, details("accepted", 2, report=REPORT)),
    ]
    done = daemon.run("start", "--ball-diameter-mm", "10", "--by", "me", "--key", "secret", "--follow")
    assert done.exit_code == 0, done.output
    assert daemon.asked[0] == (
        "POST",
        "/api/v1/calibrations",
        "Bearer secret",
        {"ball_diameters_mm": [10.0], "method": "bundle", "by": "me"},
    )
    assert "but the rig is" not in done.output
    assert done.output.count("residual up to 12.30 px; still missing: 3 more drops") == 2
    assert "held out 0.050 px, length +-0.0100 %, 2 drops used" in done.output
    assert "c02: it was moved: fasten it" in done.output
    assert "0.031" in done.output


def test_a_rig_that_is_disarmed_is_told_at_the_start(daemon: Pretender):
    """After the cameras were placed the rig stayed disarmed, and the balls of a calibration fell unseen."""
    daemon.answers = [(201, details("collecting")), (200, {"state": "disarmed"})]
    assert "but the rig is disarmed, and sees nothing that falls" in daemon.run("start").output


def test_it_waits_for_the_solution_and_tells_why_there_is_none(daemon: Pretender):
    failed = {**details("collecting"), "detail": "too few drops"}
    daemon.answers = [(202, details("solving")), (200, details("solving")), (200, failed)]
    done = daemon.run("solve", "0002")
    assert done.exit_code == 1
    assert "too few drops" in str(done.exception)
    daemon.answers = [(202, details("solving")), (200, details("solved", report=REPORT))]
    done = daemon.run("solve", "0002", "--json")
    assert json.loads(done.output)["report"] == REPORT


@pytest.mark.parametrize("action", ["accept", "reject", "cancel", "activate"])
def test_every_decision_is_one_request(daemon: Pretender, action: str):
    daemon.answers = [(200, {**details("accepted"), "is_active": action == "activate"})]
    done = daemon.run(action, "0002", "--by", "me")
    assert daemon.asked == [("POST", f"/api/v1/calibrations/0002/{action}", None, {"by": "me"})]
    assert done.output == f"calibration 0002 is {'in use' if action == 'activate' else 'accepted'}\n"


def test_a_verification_ends_with_its_verdict(daemon: Pretender):
    found: dict[str, Any] = {
        "id": "0001",
        "state": "collecting",
        "balls": [],
        "problems": [],
        "summary": None,
    }
    ball = {"bundle": "7", "equivalent_diameter_mm": 15.2, "detail": None}
    verdict = {**found, "state": "failed", "balls": [ball], "problems": ["0.200 mm off"]}
    daemon.answers = [(201, found), (200, verdict)]
    done = daemon.run("verify", "--count", "2")
    assert (done.exit_code, str(done.exception)) == (1, "verification 0001 failed: 0.200 mm off")
    assert "7: 15.200 mm" in done.output
    summary = {"error_mm": 0.01, "sd_mm": 0.002, "vertical_minus_horizontal_mm": None}
    daemon.answers = [(201, found), (200, {**verdict, "state": "passed", "summary": summary})]
    assert "passed: diameter +0.010 mm off" in daemon.run("verify").output


def test_a_refusal_is_told_in_the_daemons_words(daemon: Pretender):
    daemon.answers = [(409, {"detail": "calibration 0002 is collecting: end it first"})]
    done = daemon.run("start", "--ball-diameter-mm", "10")
    assert str(done.exception) == "refused: calibration 0002 is collecting: end it first"
    daemon.answers = [(502, [])]  # type: ignore[list-item]  # a proxy's own words
    assert str(daemon.run("list").exception) == "refused: 502 Bad Gateway"


@pytest.mark.parametrize("url", ["http://127.0.0.1:1", "file:///etc/passwd", "127.0.0.1:8080"])
def test_without_a_daemon_it_says_where_it_looked(url: str):
    done = CliRunner().invoke(build_app(["calibration"]), ["calibration", "list", "--url", url])
    assert done.exit_code == 1
    assert url in str(done.exception)
