"""An upgrade of the algorithm: the command has the daemon measure its stones again, over kills; a client follows."""

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.cluster import LocalCluster
from support.daemon_process import DaemonProcess, free_port
from support.eventually import eventually
from support.reference_client import start_client
from support.remeasuring import OLD, make_old
from support.small_recording import write_small_recording
from support.warm_stonefall import WarmStonefall, run_stonefall, start_stonefall

from service.results.fields import MEASURED_FIELDS
from service.results.version import ALGORITHM_VERSION

N_STONES = 5
OF_THE_STONE = ("id", "session", "bundle", "sequence", "kind", "captured_at", "is_simulated", "is_replay")
OF_THE_LOT = ("mass_g", "density_kg_m3")
"""Measured fields that a stone has by the product of its lot, which it was put into after it was measured."""
NUMBERS = (
    "outcome", "reason", "quality", "quality_causes", "views", "dropped_views", "segmenters", "segmentation_flags",
    *(name for name in MEASURED_FIELDS if name not in OF_THE_LOT), "gate_extent_mm", "view_residuals_px",
    "tangency_px", "image_shifts_px", "optics", "calibration_id",
)  # fmt: skip
EVER = {"since": "2000-01-01T00:00:00Z", "until": "2100-01-01T00:00:00Z"}


def remeasure(daemon: DaemonProcess, *options: str) -> WarmStonefall:
    return start_stonefall("remeasure", "--config", daemon.config_path, "--json", *options)


def summary(command: WarmStonefall) -> dict[str, Any]:
    """Return what the command prints once it has ended."""
    printed, told = command.communicate()
    assert command.returncode == 0, told
    return dict(json.loads(printed))


def n_archived(folder: Path) -> int:
    return len(list(folder.glob("state/particles/*/*/bundle.tiff")))


def newest_of(items: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    return {item["id"]: item for item in items}


def client_has(path: Path) -> dict[str, tuple[int, int]]:
    with closing(sqlite3.connect(path)) as database:
        rows = database.execute("SELECT id, seq, record ->> 'revision' FROM stones").fetchall()
    return {name: (seq, revision) for name, seq, revision in rows}


def assert_measured_again_alike(folder: Path, before: dict[str, Any], again: dict[str, Any]) -> None:
    assert {name: again[name] for name in OF_THE_STONE} == {name: before[name] for name in OF_THE_STONE}
    assert {name: again[name] for name in NUMBERS} == {name: before[name] for name in NUMBERS}
    assert (before["algorithm_version"], again["algorithm_version"]) == (OLD, ALGORITHM_VERSION)
    assert again["mesh"] == f"particles/{again['seq']}/mesh.ply"
    (mesh,) = folder.glob(f"state/particles/*/{again['id']}/r2/mesh.sfmesh")
    assert mesh.read_bytes() == (mesh.parents[1] / "mesh.sfmesh").read_bytes()


@contextmanager
def old_archive(folder: Path, recording: Path, port: int) -> Iterator[DaemonProcess]:
    """Provide a daemon that has archived its stones; it is stopped, and an older algorithm has measured them."""
    write_small_recording(recording, n_stones=N_STONES)
    with DaemonProcess(folder, recording, port=port) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda found: found["measured"] == N_STONES)
        eventually(lambda: n_archived(folder) == N_STONES)
        yield daemon
        assert daemon.stop() == 0
    make_old(folder / "state")


def remove_frames(folder: Path, daemon: DaemonProcess) -> str:
    """Remove the archived frames of the fifth stone, and return its id."""
    name = str(daemon.get("/particles/5")["id"])
    next(folder.glob(f"state/particles/*/{name}/bundle.tiff")).unlink()
    return name


@pytest.mark.full
def test_stones_are_measured_again_once_with_the_same_numbers_over_kills(tmp_path: Path) -> None:
    recording, port = tmp_path / "recording", free_port()
    with old_archive(tmp_path, recording, port) as daemon:
        daemon.put("/products/basalt", {"title": "8/16", "density_kg_m3": 2700})
        daemon.post("/lots", {"lot": "L1", "product": "basalt"})
        assert daemon.post("/lots/L1/assign", EVER)["n_assigned"] == N_STONES
        assert daemon.post("/lots/L1/close", {})["revision"] == 1

    following = start_client(f"http://127.0.0.1:{port}", tmp_path / "mes.sqlite", "--consumer", "mes")
    try:
        with DaemonProcess(tmp_path, recording, port=port) as daemon:
            daemon.hear("READY=1")
            daemon.wait_for("/accounting", lambda found: found["measured"] == 2 * N_STONES)
            without = remove_frames(tmp_path, daemon)
            command = remeasure(daemon)
            daemon.wait_for("/results?after=10", lambda found: found["items"])
            daemon.process.kill()
            daemon.process.wait()
            command.communicate()  # done just before the kill, or one line that says that nobody answers
            assert command.returncode in (0, 1)
        with DaemonProcess(tmp_path, recording, port=port) as daemon:
            daemon.hear("READY=1")
            daemon.wait_for("/accounting", lambda found: found["measured"] == 3 * N_STONES)
            first = summary(
                remeasure(daemon, "--lot", "L1", "--since", EVER["since"], "--until", EVER["until"])
            )
            assert first["failed"] == {}
            assert first["without_frames"] == [without]
            assert len(first["revised"]) + len(first["unchanged"]) == N_STONES - 1
            second = summary(remeasure(daemon))
            assert (second["revised"], len(second["unchanged"])) == ([], 3 * N_STONES - 1)

            items = daemon.results()
            assert [item["seq"] for item in items] == list(range(1, 4 * N_STONES))
            by_seq = {item["seq"]: item for item in items}
            later = [item for item in items if item["revision"] > 1]
            assert [(item["revision"], item["revises"]) for item in later] == [
                (2, n) for n in range(1, N_STONES)
            ]
            for again in later:
                before = by_seq[again["revises"]]
                assert_measured_again_alike(tmp_path, before, again)
            counts = daemon.get("/accounting")
            assert (counts["triggers"], counts["measured"]) == (3 * N_STONES, 3 * N_STONES)
            assert daemon.get("/lots/L1")["revision"] == N_STONES
            sides = (OLD, ALGORITHM_VERSION, "--lot", "L1", "--url", f"http://127.0.0.1:{port}")
            limits = ("--max-volume-percent", "0", "--max-axes-mm", "0", "--max-passing-percent", "0")
            compared = run_stonefall("compare", *sides, *limits, "--same-words", check=True)
            assert "equal, bit for bit" in compared.stdout
            assert f"1 stones are in the old results alone: {without}" in compared.stdout
            entries = [
                each for each in daemon.get("/audit")["items"] if each["action"] == "particle remeasured"
            ]
            assert len(entries) == N_STONES - 1

            wanted = {name: (item["seq"], item["revision"]) for name, item in newest_of(items).items()}
            assert len(wanted) == 3 * N_STONES
            eventually(lambda: client_has(tmp_path / "mes.sqlite") == wanted)
            assert daemon.stop() == 0
    finally:
        following.terminate()
        following.wait()
    assert "Traceback" not in daemon.log


@pytest.mark.full
def test_a_cluster_measures_stones_again_over_kills_of_the_command_and_of_a_worker(tmp_path: Path) -> None:
    recording, port = tmp_path / "recording", free_port()
    with old_archive(tmp_path, recording, port):
        pass
    with (
        DaemonProcess(tmp_path, recording, port=port) as daemon,
        LocalCluster(tmp_path / "cluster", n_workers=2) as cluster,
    ):
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda found: found["measured"] == 2 * N_STONES)
        without = remove_frames(tmp_path, daemon)
        on_cluster = ("--executor", cluster.executor, "--until", EVER["until"])

        command = remeasure(daemon, *on_cluster)
        eventually(lambda: bool(cluster.jobs(0)))
        command.kill()
        command.communicate()
        command = remeasure(daemon, *on_cluster)
        eventually(lambda: bool(cluster.jobs(0)))
        cluster.kill_worker(0)
        done = summary(command)
        assert (done["failed"], done["without_frames"]) == ({}, [without])
        assert len(done["revised"]) + len(done["unchanged"]) == 2 * N_STONES - 1
        assert summary(remeasure(daemon, *on_cluster))["revised"] == []  # and asks the cluster for nothing

        items = daemon.results()
        assert [item["seq"] for item in items] == list(range(1, 3 * N_STONES))
        by_seq = {item["seq"]: item for item in items}
        later = [item for item in items if item["revision"] > 1]
        assert {item["revises"] for item in later} == set(range(1, N_STONES))
        for again in later:
            assert_measured_again_alike(tmp_path, by_seq[again["revises"]], again)
        entries = [each for each in daemon.get("/audit")["items"] if each["action"] == "particle remeasured"]
        assert len(entries) == N_STONES - 1
        assert daemon.stop() == 0
    assert "Traceback" not in daemon.log
