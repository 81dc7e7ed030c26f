"""`stonefall measure --executor` on a local cluster: the bits of this machine, over killed workers and processes."""

import json
import os
import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.cluster import LocalCluster
from support.daemon_process import descendants_of, process_name
from support.eventually import eventually
from support.small_recording import write_small_recording
from support.warm_stonefall import WarmStonefall, start_stonefall

from service.processing.worker_pool import WORKER_NAME

N_STONES = 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a recording, and what was measured of it here."""
    folder = tmp_path_factory.mktemp("cluster")
    write_small_recording(folder / "recording", n_stones=N_STONES)
    finished(measure(folder, "recording", folder / "here"))
    return folder


def measure(folder: Path, recording: str, out: Path, *options: str) -> WarmStonefall:
    arguments = ("measure", recording, "--out", out, "--save-silhouettes", "--json", *options)
    return start_stonefall(*arguments, folder=folder)


def finished(command: WarmStonefall) -> dict[str, Any]:
    printed, told = command.communicate()
    assert command.returncode == 0, told
    return dict(json.loads(printed))


def untimed(out: Path) -> list[dict[str, Any]]:
    records = [json.loads(line) for line in (out / "results.jsonl").read_text().splitlines()]
    return [{name: value for name, value in record.items() if name != "timings_ms"} for record in records]


def files(out: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(out)): path.read_bytes()
        for kind in ("meshes", "silhouettes")
        for path in (out / kind).rglob("*.*")
    }


@contextmanager
def measuring(
    folder: Path, tmp_path: Path, *, n_workers: int, recording: str = "recording"
) -> Iterator[tuple[LocalCluster, WarmStonefall]]:
    """Provide a cluster and the command that measures on it, as soon as its first worker measures a bundle."""
    with LocalCluster(tmp_path / "cluster", n_workers=n_workers) as cluster:
        command = measure(folder, recording, tmp_path / "there", "--executor", cluster.executor)
        eventually(lambda: bool(cluster.jobs(0)))
        yield cluster, command


@pytest.mark.full
def test_a_killed_worker_costs_nothing_and_bits_are_those_of_this_machine(
    folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "there"
    with measuring(folder, tmp_path, n_workers=2) as (cluster, command):
        cluster.kill_worker(0)
        assert finished(command) == {"bundles": N_STONES, "measured": N_STONES, "rejected": 0, "lost": 0}
    assert untimed(out) == untimed(folder / "here")
    assert files(out) == files(folder / "here")
    assert len(files(out)) == N_STONES * 17


@pytest.mark.full
def test_a_bundle_that_kills_its_processes_is_lost_alone(folder: Path, tmp_path: Path) -> None:
    with measuring(folder, tmp_path, n_workers=1) as (cluster, command):
        for _ in range(2):
            eventually(lambda: bool(cluster.jobs(0)))
            measurers = [
                pid for pid in descendants_of(cluster.workers[0].pid) if process_name(pid) == WORKER_NAME
            ]
            for pid in measurers:
                os.kill(pid, signal.SIGSTOP)
            (job,) = cluster.jobs(0)
            shutil.rmtree(job)  # it comes again with the next attempt
            for pid in measurers:
                os.kill(pid, signal.SIGKILL)
        assert finished(command) == {"bundles": N_STONES, "measured": N_STONES - 1, "rejected": 0, "lost": 1}
    records = {record["bundle"]: record for record in untimed(tmp_path / "there")}
    (lost,) = [record for record in records.values() if record["outcome"] == "lost"]
    assert (lost["reason"], "died" in lost["detail"]) == ("worker_crash", True)
    others = {record["bundle"]: record for record in untimed(folder / "here")}
    del records[lost["bundle"]], others[lost["bundle"]]
    assert records == others


@pytest.mark.full
def test_a_scheduler_that_goes_away_ends_the_command_with_one_error(folder: Path, tmp_path: Path) -> None:
    with measuring(folder, tmp_path, n_workers=1) as (cluster, command):
        cluster.kill_scheduler()
        _, told = command.communicate()
    assert command.returncode == 1
    assert "stonefall: the scheduler is gone" in told
    assert not (tmp_path / "there" / "results.jsonl").exists()


@pytest.mark.full
def test_without_a_scheduler_it_is_one_line(folder: Path, tmp_path: Path) -> None:
    command = measure(folder, "recording", tmp_path / "there", "--executor", "dask://127.0.0.1:9")
    _, told = command.communicate()
    assert command.returncode == 1
    assert "no scheduler answers at tcp://127.0.0.1:9" in told
    assert "Traceback" not in told


@pytest.mark.full
def test_a_recording_that_is_not_shared_is_named(folder: Path, tmp_path: Path) -> None:
    # this path is another folder to each process
    recording = Path("/proc/self/cwd/recording")
    with LocalCluster(tmp_path / "cluster", n_workers=1) as cluster:
        command = measure(folder, str(recording), tmp_path / "there", "--executor", cluster.executor)
        _, told = command.communicate()
    assert command.returncode == 1
    assert f"cannot measure: {recording}" in told and "share its folder with all machines" in told
