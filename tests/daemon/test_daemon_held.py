"""The real process while its disk refuses to write: it answers, says why, counts what falls, and goes on by itself."""

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.daemon_process import DaemonProcess
from support.extents import first_quick
from support.small_recording import write_small_recording

from service.store.accounting import accounting
from service.store.schema import connect_reader


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("held") / "recording"
    write_small_recording(path, n_stones=6)
    return path


@contextmanager
def locked(state_dir: Path) -> Iterator[None]:
    with closing(sqlite3.connect(state_dir / "results.sqlite", isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        yield
        other.execute("ROLLBACK")


@contextmanager
def unwritable(state_dir: Path) -> Iterator[None]:
    """Have a file in the place of the folder for the files of particles."""
    folder = state_dir / "particles"
    folder.rename(state_dir / "elsewhere")
    folder.touch()
    yield
    folder.unlink()
    (state_dir / "elsewhere").rename(folder)


def detail_of_store(health: dict[str, Any]) -> str:
    return str(health["checks"]["store"]["detail"])


def alarm_of_store(alarms: dict[str, Any]) -> list[dict[str, Any]]:
    return [each for each in alarms["items"] if each["check"] == "store"]


def of_store(events: dict[str, Any]) -> list[str]:
    return [each["type"] for each in events["items"] if each["subject"] == "store"]


def is_armed(answer: dict[str, Any]) -> bool:
    return bool(answer["state"] == "armed")


@pytest.mark.parametrize(
    ("refusing", "remedy"),
    first_quick([(locked, "end the program that has the database"), (unwritable, "make store.dir writable")]),
)
@pytest.mark.full
def test_a_store_that_cannot_be_written_holds_and_goes_on_by_itself(
    recording: Path,
    tmp_path: Path,
    refusing: Callable[[Path], AbstractContextManager[None]],
    remedy: str,
) -> None:
    state = tmp_path / "state"
    rig = "loop = true\nspeed = 2.0"
    with DaemonProcess(tmp_path, recording, rig=rig, max_bundles=3) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda now: now["measured"] >= 1)
        with refusing(state):
            held = daemon.wait_for("/acquisition", lambda answer: answer["state"] == "held")
            assert remedy in held["trouble"]
            # more falls than can wait
            daemon.wait_for("/acquisition", lambda answer: answer["triggers"] >= held["triggers"] + 8)
            health = daemon.get("/health")
            assert (health["ne107"], health["ready"]) == ("failure", False)
            assert remedy in detail_of_store(health)
            assert daemon.get("/results?after=0")["last_seq"] >= 1
            (alarm,) = daemon.wait_for("/alarms", lambda now: alarm_of_store(now) != [])["items"][:1]
            assert (alarm["check"], alarm["priority"], remedy in alarm["detail"]) == ("store", "urgent", True)
            acknowledged = daemon.post(f"/alarms/{alarm['id']}/acknowledge", {})  # written later
            assert acknowledged["state"] == "acknowledged"
            assert daemon.process.poll() is None
        daemon.wait_for("/acquisition", is_armed)
        daemon.wait_for("/accounting", lambda now: now["by_reason"].get("store_held", 0) >= 1)
        measured = daemon.get("/accounting")["measured"]
        daemon.wait_for("/accounting", lambda now: now["measured"] > measured + 1)
        assert daemon.put("/acquisition", {"state": "disarmed"})["state"] in ("disarming", "disarmed")
        fallen = daemon.wait_for("/acquisition", lambda answer: answer["state"] == "disarmed")
        counts = daemon.wait_for("/accounting", lambda now: now["in_progress"] == 0)
        # exposures of the empty rig have no outcome, and are counted only if the store was written
        results = daemon.results()
        assert counts["is_balanced"]
        assert counts["triggers"] == len(results)
        n_backgrounds = fallen["triggers"] - counts["triggers"]
        assert n_backgrounds >= counts["backgrounds"]
        sequences = [result["sequence"] for result in results]
        assert sequences == sorted(sequences)
        daemon.wait_for("/alarms", lambda now: alarm_of_store(now) == [])
        events = daemon.wait_for("/events?limit=1000", lambda now: of_store(now)[-1:] == ["alarm.cleared"])
        assert of_store(events) == ["alarm.raised", "alarm.acknowledged", "alarm.cleared"]
        assert [item["seq"] for item in events["items"]] == list(range(1, events["last_seq"] + 1))
        changed = [each["data"]["state"] for each in events["items"] if each["type"] == "acquisition.changed"]
        assert changed[:4] == ["arming", "armed", "held", "armed"]
        assert changed[-2:] == ["disarming", "disarmed"]
        actions = [entry["action"] for entry in daemon.get("/audit")["items"]]
        assert actions == ["alarm acknowledged", "acquisition disarmed"]
        assert daemon.stop() == 0
        assert "Traceback" not in daemon.log


@pytest.mark.full
def test_a_held_daemon_can_be_stopped(recording: Path, tmp_path: Path) -> None:
    rig = "loop = true\nspeed = 2.0"
    with DaemonProcess(tmp_path, recording, rig=rig, max_bundles=3) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda now: now["measured"] >= 1)
        with locked(tmp_path / "state"):
            daemon.wait_for("/acquisition", lambda answer: answer["state"] == "held")
            daemon.process.send_signal(2)
            daemon.wait_for("/acquisition", lambda answer: answer["state"] == "stopping")
            assert daemon.stop() == 0
            assert "outcomes are given up" in daemon.log
            assert "Traceback" not in daemon.log
    with connect_reader(tmp_path / "state/results.sqlite") as connection:
        assert accounting(connection, None).is_balanced


@pytest.mark.full
def test_a_damaged_store_is_moved_aside_and_named_and_measuring_goes_on(
    recording: Path, tmp_path: Path
) -> None:
    with DaemonProcess(tmp_path, recording) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda now: now["measured"] == 6)
        before = daemon.get("/results?after=0")["instance_id"]
        assert daemon.stop() == 0
    database = tmp_path / "state/results.sqlite"
    content = database.read_bytes()
    database.write_bytes(content[:4096] + b"\xa5" * (len(content) - 4096))
    with DaemonProcess(tmp_path, recording) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda now: now["measured"] == 6)
        page = daemon.get("/results?after=6")
        assert page["instance_id"] != before
        assert [item["seq"] for item in page["items"]] == [7, 8, 9, 10, 11, 12]
        health = daemon.get("/health")
        assert health["checks"]["store"]["status"] == "warn"
        assert "The database was damaged" in detail_of_store(health)
        assert daemon.stop() == 0
    assert len(list(tmp_path.glob("state/aside/*/particles/*/mesh.sfmesh"))) == 6


@pytest.mark.full
def test_damage_that_shows_while_it_runs_is_an_alarm_and_no_end(recording: Path, tmp_path: Path) -> None:
    database = tmp_path / "state/results.sqlite"
    with DaemonProcess(tmp_path, recording, rig="loop = true\nspeed = 2.0") as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda now: now["measured"] >= 1)
        daemon.put("/acquisition", {"state": "disarmed"})
        daemon.wait_for("/acquisition", lambda answer: answer["state"] == "disarmed")
        daemon.wait_for("/accounting", lambda now: now["in_progress"] == 0)
        with closing(sqlite3.connect(database)) as other:  # nothing may be in the WAL alone
            other.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        with database.open("r+b") as file:
            size = file.seek(0, 2)
            file.seek(4096)
            file.write(b"\xa5" * (size - 4096))
        problem = daemon.get("/results?after=0")
        assert problem["type"] == "urn:stonefall:problem:store-damaged"
        health = daemon.get("/health")
        assert (health["ne107"], health["ready"]) == ("failure", False)
        assert "restore a backup" in detail_of_store(health)
        daemon.put("/acquisition", {"state": "armed"})
        daemon.wait_for("/acquisition", lambda answer: answer["state"] == "held")
        assert daemon.stop() == 0
        assert "Traceback" not in daemon.log
