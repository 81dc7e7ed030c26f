"""The real process killed, its workers killed, its folder on tmpfs deleted: what it costs, and who is told."""

import asyncio
import os
import shutil
import signal
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from support.daemon_process import DaemonProcess, descendants_of, is_running
from support.eventually import eventually
from support.left_in_spool import open_triggers, whole_bundles
from support.outcomes import trigger
from support.small_recording import write_small_recording

from drivers.files.recording import read_bundle
from pipeline.frames import CameraId
from service.store import open_store
from service.store.writes import MAX_LOST

LOOP = "loop = true\nspeed = 2.0"
N_STONES = MOST_WAITING = 6
CAMERAS = tuple(CameraId(f"c{number:02d}") for number in range(1, 17))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("crash") / "recording"
    write_small_recording(path, n_stones=N_STONES)
    return path


def kill(daemon: DaemonProcess) -> None:
    """Kill the daemon, and see its workers end."""
    workers = daemon.worker_pids()
    daemon.process.kill()
    daemon.process.wait()
    for pid in workers:  # some may be stopped, others have seen the end already
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
    eventually(lambda: not any(is_running(pid) for pid in workers))


def outcome_of(results: list[dict[str, Any]]) -> dict[tuple[int, str], dict[str, Any]]:
    """Return the results by session and bundle, of which none may be there twice."""
    found = {(result["session"], result["bundle"]): result for result in results}
    assert len(found) == len(results)
    return found


def test_after_a_kill_the_next_daemon_measures_what_lay_in_the_spool_once(
    recording: Path, tmp_path: Path
) -> None:
    # however long this takes, not more than these wait
    with DaemonProcess(tmp_path, recording, rig=LOOP, max_bundles=MOST_WAITING) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda now: now["measured"] >= 1)
        daemon.signal_workers(signal.SIGSTOP)
        daemon.wait_for("/accounting", lambda now: now["in_progress"] >= 4)
        kill(daemon)
    left = open_triggers(tmp_path)
    there = {name for _, name in whole_bundles(tmp_path, CAMERAS)}
    assert len(there) >= 2
    with DaemonProcess(
        tmp_path, recording, rig=LOOP, max_bundles=MOST_WAITING
    ) as daemon:  # killed while it makes up for it
        daemon.hear("WATCHDOG=1")
        daemon.wait_for("/accounting?session=1", lambda now: now["in_progress"] < len(there))
        kill(daemon)
    with DaemonProcess(tmp_path, recording) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting?session=3", lambda now: now["triggers"] == N_STONES)
        daemon.wait_for("/accounting", lambda now: now["in_progress"] == 0)
        results = outcome_of(daemon.results())
        assert daemon.stop() == 0
    assert open_triggers(tmp_path) == []
    for session, name in left:
        result = results[session, name]
        expected = ("measured", None) if name in there else ("lost", "crash")
        assert (result["outcome"], result["reason"]) == expected, result["detail"]
    twins = [result for result in results.values() if result["session"] == 3 and result["sieve_size_mm"]]
    for name in there:  # as the same stone is measured without a crash
        seen = results[1, name]
        stone = name.split("-", 1)[0]
        assert any(abs(twin["sieve_size_mm"] - seen["sieve_size_mm"]) < 0.05 for twin in twins), stone
    assert list((tmp_path / "spool").iterdir()) == []


@pytest.mark.full
def test_thousands_of_open_triggers_delay_no_start_and_each_is_lost(recording: Path, tmp_path: Path) -> None:
    n_open = 2 * MAX_LOST + 1
    asyncio.run(leave_open(tmp_path / "state", n_open))
    with DaemonProcess(tmp_path, recording, rig=LOOP) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting?session=2", lambda now: now["measured"] >= 1)
        counts = daemon.wait_for("/accounting?session=1", lambda now: now["in_progress"] == 0)
        assert (counts["triggers"], counts["by_reason"]) == (n_open, {"crash": n_open})
        assert daemon.stop() == 0


async def leave_open(state_dir: Path, n_open: int) -> None:
    """Leave a store as a daemon does that is killed before these stones have their outcome."""
    with open_store(state_dir) as store:
        session = await store.begin_session({"is_replay": True, "is_simulated": True})
        await store.record_triggers(session, {f"{number}": trigger(number) for number in range(n_open)})


@pytest.mark.full
def test_a_bundle_that_kills_its_workers_is_kept_and_named(recording: Path, tmp_path: Path) -> None:
    with DaemonProcess(tmp_path, recording, rig=LOOP) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda now: now["measured"] >= 1)
        for _ in range(2):
            daemon.wait_for("/accounting", lambda _: bool(list((tmp_path / "spool").glob("*/*/job-*"))))
            daemon.signal_workers(signal.SIGSTOP)
            # they come again with the next attempt; that of a stone just measured may be there still
            for job in (tmp_path / "spool").glob("*/*/job-*"):
                shutil.rmtree(job)
            daemon.signal_workers(signal.SIGSEGV)
            daemon.signal_workers(signal.SIGCONT)
        daemon.wait_for("/accounting", lambda now: "worker_crash" in now["by_reason"])
        (lost,) = [result for result in daemon.results() if result["reason"] == "worker_crash"]
        name = f"{lost['session']}-{lost['bundle']}.tiff"
        check = daemon.check("quarantine", lambda now: now["status"] == "warn")
        assert check["detail"] == f"no worker survived {name}"
        assert read_bundle(tmp_path / "state/quarantine" / name, CAMERAS).name == lost["bundle"]
        measured = daemon.get("/accounting")["measured"]
        daemon.wait_for("/accounting", lambda now: now["measured"] > measured)
        assert daemon.stop() == 0


@pytest.mark.full
@pytest.mark.parametrize("is_deleted", [True, False], ids=["spool", "fork server"])
def test_what_is_taken_from_a_running_daemon_comes_back(
    is_deleted: bool, recording: Path, tmp_path: Path
) -> None:
    with DaemonProcess(tmp_path, recording, rig=LOOP, slots=2) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda now: now["measured"] >= 1)
        take_away: Callable[[], None] = (
            (lambda: delete(tmp_path / "spool")) if is_deleted else (lambda: kill_fork_server(daemon))
        )
        name, trouble = ("queue", "was deleted") if is_deleted else ("workers", "died")
        for _ in range(3):
            measured = daemon.get("/accounting")["measured"]
            take_away()
            check = daemon.check(name, lambda now: trouble in (now["detail"] or ""))
            assert check["status"] != "pass"
            daemon.wait_for("/accounting", lambda now, before=measured: now["measured"] >= before + 2)
        assert daemon.stop() == 0


def delete(folder: Path) -> None:
    eventually(folder.exists)
    gone = folder.with_name("gone")
    folder.rename(gone)  # at once: it is written to
    shutil.rmtree(gone, ignore_errors=True)


def kill_fork_server(daemon: DaemonProcess) -> None:
    """Kill what the workers are forked from."""
    theirs = set(descendants_of(daemon.process.pid))  # a worker whose server has ended has another parent
    with suppress(FileNotFoundError, ProcessLookupError):  # they may end meanwhile
        for server in {parent_of(pid) for pid in daemon.worker_pids()} & theirs:
            os.kill(server, signal.SIGKILL)


def parent_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1].split()[1])


def is_full_and_lost(queue: dict[str, Any]) -> bool:
    return queue["status"] == "fail" and "stones lost" in queue["detail"]


@pytest.mark.full
def test_overload_loses_the_newest_whole_is_named_and_ends_by_itself(recording: Path, tmp_path: Path) -> None:
    with DaemonProcess(tmp_path, recording, rig=LOOP, max_bundles=2) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda now: now["measured"] >= 1)
        daemon.signal_workers(signal.SIGSTOP)
        daemon.wait_for("/accounting", lambda now: now["in_progress"] >= 5)
        health = daemon.wait_for("/health", lambda now: is_full_and_lost(now["checks"]["queue"]))
        assert health["ne107"] == "failure"
        assert daemon.get("/acquisition")["state"] == "armed"  # and what falls is counted
        measured = daemon.get("/accounting")["measured"]
        daemon.signal_workers(signal.SIGCONT)
        daemon.wait_for("/accounting", lambda now: now["measured"] >= measured + 5)  # while stones fall
        daemon.put("/acquisition", {"state": "disarmed"})
        accounting = daemon.wait_for("/accounting", lambda now: now["in_progress"] == 0)
        check = daemon.check("queue", lambda now: now["observed_value"] == 0)
        assert check["status"] == "warn"
        assert "stones lost since the start (2 bundles were waiting)" in check["detail"]
        results = daemon.results()
        lost = [result["reason"] == "queue_full" for result in results]
        begin = [result["outcome"] for result in results].index("measured")  # a slow start loses some, too
        first = lost.index(True, begin)
        assert accounting["is_balanced"]
        assert accounting["triggers"] == len(outcome_of(results)) == len(lost)
        # those that were there before the spool was full are measured, and those after it had room again
        assert {result["outcome"] for result in results[begin:first]} == {"measured"}
        assert not all(lost[first:])
        assert daemon.stop() == 0
