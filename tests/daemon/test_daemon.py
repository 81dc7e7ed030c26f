"""The real process on a small recording: what is promised to the plant when things go well and when not."""

import json
import multiprocessing
import os
import signal
import socket
import sqlite3
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from support.daemon_process import PATIENCE_S, DaemonProcess, is_running
from support.small_recording import write_small_recording
from support.stores import folder_of

from drivers.files.recording import open_recording, playback_order
from drivers.files.rig_file import read_rig
from pipeline.carving import CarvingParameters
from pipeline.frames import BundleKind
from pipeline.particle import BodyParameters, PipelineParameters
from service.health.alarms.rules import load_rules
from service.processing.measure_job import (
    COMPACT_MESH,
    MeasureJob,
    RigFile,
    WorkerContext,
    initialize,
    learn_background,
    measure,
)
from service.results.record import document_of
from service.store import open_store
from service.store.accounting import Accounting, accounting
from service.store.schema import connect_reader

N_STONES = 6


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("daemon") / "recording"
    write_small_recording(path, n_stones=N_STONES)
    return path


@pytest.fixture(scope="session")
def offline(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """The records that one worker makes of the recording, without a daemon."""
    return measured_offline(recording, tmp_path_factory.mktemp("offline"))


def is_through(accounting: dict[str, Any]) -> bool:
    return accounting["triggers"] == N_STONES and accounting["in_progress"] == 0


def measured_offline(path: Path, out: Path) -> list[dict[str, Any]]:
    recording = open_recording(path)
    context = WorkerContext(
        parameters=PipelineParameters(carving=CarvingParameters(n=64), body=BodyParameters("estimate")),
        is_simulated=True,
        compact_meshes=True,
    )
    rig = RigFile(path / "rig.json", read_rig(path / "rig.json").calibration_id)
    background: Path | None = None
    records = []
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn, initializer=initialize, initargs=(context,)) as worker:
        for header in playback_order(recording):
            if header.kind is BundleKind.BACKGROUND:
                previous, background = background, out / f"{header.name}.background"
                learn = partial(
                    learn_background,
                    bundle_path=header.path,
                    camera_ids=recording.camera_ids,
                    previous_path=previous,
                    out_path=background,
                )
                worker.submit(learn).result()
                continue
            job = MeasureJob(
                bundle_path=header.path,
                camera_ids=recording.camera_ids,
                rig_file=rig,
                background_path=background,
                out_dir=out / header.name,
            )
            record = worker.submit(measure, job).result().record
            document = json.loads(json.dumps(document_of(record)))
            records.append(document | {"mesh": (job.out_dir / COMPACT_MESH).read_bytes()})
    return records


def assert_same_results(folder: Path, results: list[dict[str, Any]], offline: list[dict[str, Any]]) -> None:
    """Bit for bit the same records and meshes, times of processing apart."""
    for result, record in zip(results, offline, strict=True):
        mesh = (folder_of(folder / "state", result["id"]) / COMPACT_MESH).read_bytes()
        kept = {key: value for key, value in record.items() if key != "timings_ms"}
        assert {key: (result | {"mesh": mesh})[key] for key in kept} == kept


def accounting_in(folder: Path) -> Accounting:
    """What the daemon has left in its store."""
    with connect_reader(folder / "state/results.sqlite") as connection:
        return accounting(connection, None)


def seqs(results: list[dict[str, Any]]) -> list[int]:
    return [result["seq"] for result in results]


def test_a_recording_runs_through_and_sigterm_ends_it(
    recording: Path, offline: list[dict[str, Any]], tmp_path: Path
):
    with DaemonProcess(tmp_path, recording, slots=2) as daemon:
        daemon.hear("READY=1")
        daemon.hear("WATCHDOG=1")
        daemon.wait_for("/accounting", is_through)
        daemon.wait_for("/acquisition", lambda answer: answer["state"] == "disarmed")
        results = daemon.results()
        assert seqs(results) == list(range(1, N_STONES + 1))
        assert_same_results(tmp_path, results, offline)
        accounting = daemon.get("/accounting")
        assert accounting["is_balanced"]
        assert (accounting["measured"], accounting["backgrounds"]) == (N_STONES, 2)
        health = daemon.get("/health")
        assert health["ready"] is False
        kinds = dict.fromkeys(name.partition(":")[0] for name in health["checks"])
        assert tuple(kinds) == load_rules().checks  # every part is there that has one of these
        # a busy machine holds up the loop, which is told as well
        reasons = [reason for reason in health["reasons"] if not reason.startswith("loop: ")]
        assert reasons == ["acquisition: disarmed"]
        assert {camera["frames"] for camera in daemon.get("/cameras")["items"]} == {N_STONES + 2}
        daemon.hear("STATUS=disarmed, 0 bundles waiting, last result 6")
        workers = daemon.worker_pids()
        assert len(workers) == 2
        assert daemon.stop() == 0
        daemon.hear("STOPPING=1")
        assert not any(is_running(pid) for pid in workers)
        assert list((tmp_path / "spool").iterdir()) == []
        assert "Traceback" not in daemon.log


@pytest.mark.full
def test_sigterm_in_the_middle_measures_what_was_seen(recording: Path, tmp_path: Path):
    with DaemonProcess(tmp_path, recording, rig="loop = true\nspeed = 2.0") as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda now: now["measured"] >= 1)
        daemon.signal_workers(signal.SIGSTOP)  # what is seen is not measured at once
        daemon.wait_for("/accounting", lambda now: now["in_progress"] >= 2)
        daemon.process.send_signal(signal.SIGTERM)
        daemon.hear("STOPPING=1")
        daemon.hear("EXTEND_TIMEOUT_USEC=")
        daemon.signal_workers(signal.SIGCONT)
        assert daemon.process.wait(PATIENCE_S) == 0
    accounting = accounting_in(tmp_path)
    assert accounting.is_balanced
    assert accounting.triggers >= 3
    assert accounting.triggers == accounting.measured


@pytest.mark.full
def test_a_second_signal_gives_up_what_is_waiting(recording: Path, tmp_path: Path):
    with DaemonProcess(tmp_path, recording, rig="loop = true\nspeed = 2.0") as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda now: now["measured"] >= 1)
        daemon.signal_workers(signal.SIGSTOP)
        # one of them may have been measured just before the worker stopped, and be counted as that any moment
        daemon.wait_for("/accounting", lambda now: now["in_progress"] >= 4)
        daemon.process.send_signal(signal.SIGINT)
        daemon.wait_for("/acquisition", lambda now: now["state"] == "stopping")
        assert daemon.stop() == 0
    accounting = accounting_in(tmp_path)
    assert accounting.is_balanced
    assert accounting.in_progress == 0
    assert accounting.by_reason["shutdown"] >= 3
    # on a busy machine more has fallen than the queue holds, and frames come too late
    assert accounting.by_reason.keys() <= {"shutdown", "queue_full", "no_frames"}
    assert accounting.lost == sum(accounting.by_reason.values())


@pytest.mark.full
def test_a_killed_worker_costs_one_retry_and_no_stone(
    recording: Path, offline: list[dict[str, Any]], tmp_path: Path
):
    with DaemonProcess(tmp_path, recording) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda now: now["measured"] >= 1)
        (worker,) = daemon.worker_pids()
        os.kill(worker, signal.SIGKILL)
        daemon.wait_for("/accounting", is_through)
        assert_same_results(tmp_path, daemon.results(), offline)
        daemon.check("workers", lambda now: "1 restarts" in now["detail"])
        assert worker not in daemon.worker_pids()
        assert daemon.stop() == 0


@pytest.mark.full
def test_disarm_and_arm_again_while_running(recording: Path, tmp_path: Path):
    with DaemonProcess(tmp_path, recording, rig="loop = true\nspeed = 2.0") as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/health/ready", lambda answer: answer == {"ready": True})  # the empty rig was seen
        daemon.wait_for("/accounting", lambda now: now["triggers"] >= 1)
        assert daemon.put("/acquisition", {"state": "disarmed"})["state"] in ("disarming", "disarmed")
        daemon.wait_for("/acquisition", lambda answer: answer["state"] == "disarmed")
        seen = daemon.wait_for("/accounting", lambda now: now["in_progress"] == 0)["triggers"]
        assert daemon.get("/health/ready")["status"] == 503
        daemon.put("/acquisition", {"state": "armed"})
        daemon.wait_for("/accounting", lambda now: now["triggers"] > seen)
        results = daemon.wait_for("/results?after=0", lambda page: page["last_seq"] > seen)["items"]
        assert len({result["bundle"] for result in results}) == len(results)
        assert [result["sequence"] for result in results] == sorted(r["sequence"] for r in results)
        assert daemon.stop() == 0


@pytest.mark.full
def test_a_fatal_error_ends_the_process_with_its_traceback(recording: Path, tmp_path: Path):
    open_store(tmp_path / "state").close()
    with closing(sqlite3.connect(tmp_path / "state/results.sqlite")) as database:  # no fault of the disk
        database.execute(
            "CREATE TRIGGER refuse BEFORE INSERT ON results BEGIN SELECT RAISE(ABORT, 'a bug'); END"
        )
    with DaemonProcess(tmp_path, recording) as daemon:
        assert daemon.process.wait(PATIENCE_S) == 1
        workers = daemon.worker_pids()
        assert "StoreError" in daemon.log
        assert daemon.log.count("fatal, the daemon ends") == 1
    assert workers == []


def test_a_taken_port_or_store_is_one_line_and_exit_1(recording: Path, tmp_path: Path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with DaemonProcess(tmp_path, recording, port=port) as daemon:
            assert daemon.process.wait(PATIENCE_S) == 1
        complaint = f"stonefall: api: cannot listen on 127.0.0.1 port {port}: Address already in use"
        (line,) = daemon.log.splitlines()
        assert line.startswith(complaint)
    with open_store(tmp_path / "state"), DaemonProcess(tmp_path, recording) as daemon:
        assert daemon.process.wait(PATIENCE_S) == 1
        assert "another process has the store open" in daemon.log.splitlines()[-1]


def test_a_wrong_configuration_is_one_line_and_exit_1(tmp_path: Path):
    with DaemonProcess(tmp_path, tmp_path / "nowhere") as daemon:
        assert daemon.process.wait(PATIENCE_S) == 1
        (line,) = daemon.log.splitlines()
        assert f"stonefall.toml: rig.recording: {tmp_path}/nowhere: is not a recording" in line
