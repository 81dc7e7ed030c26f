"""Addresses, contents and frames of a cluster, without one."""

import multiprocessing
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from support.small_recording import write_small_recording

from drivers.files.recording import open_recording
from service.base.errors import UsageError
from service.remeasuring.cluster import contents, tasks
from service.remeasuring.cluster.contents import content_of, keep_content, kept_content, read_content
from service.remeasuring.cluster.executor import require_distributed, scheduler_address
from service.remeasuring.cluster.tasks import ClusterJob, installed_versions


def test_an_executor_is_the_address_of_a_scheduler() -> None:
    assert scheduler_address("dask://cluster.example:8786") == "tcp://cluster.example:8786"
    assert scheduler_address("dask://[::1]:8786") == "tcp://[::1]:8786"


@pytest.mark.parametrize(
    "executor",
    [
        "",
        "cluster:8786",
        "tcp://a:1",
        "dask://a",
        "dask://:8786",
        "dask://a:x",
        "dask://a:1/path",
        "dask://u@a:1",
    ],
)
def test_what_is_none_is_refused_with_what_it_must_be(executor: str) -> None:
    with pytest.raises(UsageError, match=r"must be dask://HOST:PORT"):
        scheduler_address(executor)


def test_without_the_extra_the_error_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"extra \[cluster\].*requirements-cluster\.lock"):
        require_distributed()


def test_the_commands_import_it_only_when_asked() -> None:
    code = (
        "import sys, service.commands.measure, service.commands.remeasure\n"
        "assert not {'dask', 'distributed', 'tornado'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-W", "ignore", "-c", code], check=True)


def test_a_content_is_its_names_and_bytes(tmp_path: Path) -> None:
    first = content_of({"a": b"12", "b": b"3"})
    others = [{"a": b"1", "b": b"23"}, {"a": b"12", "c": b"3"}, {"a": b"12"}]
    assert first == content_of({"b": b"3", "a": b"12"})
    assert len({first.digest, *(content_of(files).digest for files in others)}) == 4
    (tmp_path / "folder").mkdir()
    for name, data in first.files.items():
        (tmp_path / "folder" / name).write_bytes(data)
    assert read_content(tmp_path / "folder") == first
    assert read_content(tmp_path / "folder" / "a") == content_of({"a": b"12"})


def test_a_worker_keeps_the_contents_that_were_used_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(contents, "N_KEPT", 2)
    room, made = tmp_path / "room", [content_of({"a": bytes([n])}) for n in range(3)]
    for content in made[:2]:
        assert kept_content(room, content.digest) is None
        keep_content(room, content)
        keep_content(room, content)  # once more changes nothing
    folder = kept_content(room, made[0].digest)
    assert folder is not None and read_content(folder) == made[0]
    keep_content(room, made[2])
    assert kept_content(room, made[1].digest) is None
    assert {path.name for path in room.iterdir()} == {made[0].digest, made[2].digest}


def test_frames_are_read_where_they_lie_only_if_they_are_the_same(tmp_path: Path) -> None:
    for name in ("here", "other"):
        write_small_recording(tmp_path / name, n_stones=2)
    _, _, first, second = open_recording(tmp_path / "here").headers
    job = ClusterJob(
        header=first,
        frames=None,
        camera_ids=tuple(first.frames),
        calibration_id="0",
        save_silhouettes=False,
        context="c",
        rig="r",
        background=None,
        versions={},
    )
    assert tasks._bundle_path(job, tmp_path / "job") == first.path
    first.path.write_bytes(second.path.read_bytes())  # another bundle under that name
    assert tasks._bundle_path(job, tmp_path / "job") is None
    first.path.unlink()
    assert tasks._bundle_path(job, tmp_path / "job") is None
    sent = tasks._bundle_path(replace(job, frames=second.path.read_bytes()), tmp_path / "job")
    assert sent is not None and sent.read_bytes() == second.path.read_bytes()


def test_a_worker_that_would_measure_otherwise_or_cannot_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    assert tasks._trouble(installed_versions()) is None
    assert "numpy" in installed_versions()
    told = tasks._trouble({**installed_versions(), "algorithm": "0"})
    assert told is not None and "instead of 0" in told
    monkeypatch.setitem(multiprocessing.current_process()._config, "daemon", True)  # type: ignore[attr-defined]
    told = tasks._trouble(installed_versions())
    assert told is not None and "--no-nanny" in told
