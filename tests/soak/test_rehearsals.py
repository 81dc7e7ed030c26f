"""The reference client follows each script of `stonefall rehearse`, and has in the end what a correct client has."""

import hashlib
import json
import os
import signal
import sqlite3
import subprocess
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from support.daemon_process import PATIENCE_S, STONEFALL, free_port
from support.eventually import eventually
from support.extents import Extent, first_quick
from support.reference_client import start_client

from service.commands.rehearsal.day import scripts
from service.commands.rehearsal.rehearsed_daemon import is_free

NAMES = sorted(scripts(), key=lambda name: (name != "camera-lost", name))
OF_LOAD = {"loop", "queue"}
"""Alarms that a busy machine adds to those of a script."""


@pytest.mark.full  # each takes half a minute and more
@pytest.mark.parametrize("name", first_quick(NAMES, Extent.NIGHT))
@pytest.mark.timeout(600)
def test_the_reference_client_has_what_a_correct_client_has(name: str, tmp_path: Path) -> None:
    port, database = free_port(), tmp_path / "stones.sqlite"
    url = f"http://127.0.0.1:{port}"
    command = [
        "env",
        "--default-signal=INT",
        STONEFALL,
        "rehearse",
        "--script",
        name,
        "--port",
        str(port),
        "--json",
    ]
    command += ["--folder", tmp_path / "rehearsal", "--linger-s", "500", "--speed", "1.5"]
    client = start_client(url, database, "--consumer", "mes")
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE) as rehearsal:
        try:
            assert rehearsal.stdout is not None
            line = rehearsal.stdout.readline()
            assert line, (tmp_path / "rehearsal" / "daemon.log").read_text()[-3000:]
            expected = json.loads(line)
            eventually(lambda: stored(database) == correct(expected), PATIENCE_S)
            check(name, expected)
        finally:
            client.kill()
            client.wait()
            rehearsal.send_signal(signal.SIGINT)
            rehearsal.wait(PATIENCE_S)
    assert is_free(port)
    assert "Traceback" not in database.with_suffix(".log").read_text()
    assert "Traceback" not in (tmp_path / "rehearsal" / "daemon.log").read_text()


def correct(expected: dict[str, Any]) -> dict[str, Any]:
    """Return what `stored` is to be."""
    lost = {history["instance_id"]: digest_of(history) for history in expected["earlier"]}
    return {
        "histories": {expected["instance_id"]: digest_of(expected["followed"]), **lost},
        "gaps": [tuple(gap.values()) for gap in expected["gaps"]],
    }


def digest_of(results: dict[str, Any]) -> tuple[int, str]:
    return results["results"], results["sha256"]


def stored(database: Path) -> dict[str, Any]:
    """Return what the client has of each history, as the rehearsal tells it, and its gaps."""
    with closing(sqlite3.connect(database, timeout=60)) as connection:
        rows = connection.execute("SELECT instance_id, id FROM stones ORDER BY seq").fetchall()
        gaps = connection.execute("SELECT * FROM gaps").fetchall()
    histories = {
        instance_id: digest(id_ for each, id_ in rows if each == instance_id) for instance_id, _ in rows
    }
    return {"histories": histories, "gaps": gaps}


def digest(ids: Iterable[str]) -> tuple[int, str]:
    listed = list(ids)
    return len(listed), hashlib.sha256("\n".join(listed).encode()).hexdigest()


def check(name: str, expected: dict[str, Any]) -> None:
    """Fail unless the script has shown what it is for."""
    lost = expected["earlier"]
    words = expected["health"]
    match name:
        case "cursor-expires":
            assert len(expected["gaps"]) == 1
            assert expected["first_seq"] > 20
        case "store-restored":
            assert [history["results"] >= 12 for history in lost] == [True]
        case "switch-dies":
            assert expected["outcomes"]["lost, no_frames"] >= 3
            assert "failure" in words
        case "camera-lost":
            assert "maintenance_required" in words
        case "camera-bumped" | "verification-overdue" | "clock-step":
            assert "out_of_specification" in words
    others = OF_LOAD | (
        {"retention"} if name == "cursor-expires" else set()
    )  # our consumer has not read it all
    raised = [alarm["check"] for alarm in expected["alarms"] if alarm["check"] not in others]
    assert raised == list(scripts()[name].alarms)
    assert all(alarm["cause"] and alarm["action"] for alarm in expected["alarms"])
    # in `verification-overdue` twice: never verified, and overdue
    assert all(alarm["occurrences"] <= 2 for alarm in expected["alarms"] if alarm["check"] not in OF_LOAD)
    assert {lot["state"] for lot in expected["lots"]} == {"closed"}
    assert all(
        lot["triggers"] == lot["measured"] + lot["rejected"] + lot["lost"] > 0 for lot in expected["lots"]
    )
    if name != "cursor-expires":
        assert expected["gaps"] == []
        assert expected["kept"] == expected["followed"]
        assert (expected["first_seq"], expected["outcomes"]["measured"] >= 10) == (1, True)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--script", "doomsday"], "--script doomsday: must be one of camera-bumped, "),
        (["--folder", "."], "must be empty"),
    ],
)
def test_wrong_usage_is_one_line(arguments: list[str], said: str, tmp_path: Path) -> None:
    (tmp_path / "mine").touch()
    command = [STONEFALL, "rehearse", "--port", "0", *arguments]
    done = subprocess.run(
        command, cwd=tmp_path, check=False, capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert done.returncode == 1
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.full
def test_it_ends_by_itself_and_leaves_nothing(tmp_path: Path) -> None:
    port = free_port()
    command = [
        STONEFALL,
        "rehearse",
        "--script",
        "day",
        "--port",
        str(port),
        "--linger-s",
        "0",
        "--speed",
        "4",
    ]
    done = subprocess.run(
        command,
        check=True,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )
    assert f"follow http://127.0.0.1:{port}/api/v1/results" in done.stdout
    assert "lot         L-2 (closed)" in done.stdout
    assert is_free(port)
    assert list(tmp_path.glob("stonefall-rehearse-*")) == []
