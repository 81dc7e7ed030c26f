"""Addresses, shared files and workers of a cluster, without one."""

import multiprocessing
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.small_recording import write_small_recording

from drivers.files.recording import open_recording
from pipeline.particle import PipelineParameters
from service.base.errors import UsageError
from service.processing.measure_job import MeasureJob, RigFile, WorkerContext
from service.remeasuring import cluster
from service.remeasuring.cluster import ClusterJob, installed_versions
from service.remeasuring.executor import open_cluster, scheduler_address


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


async def test_without_the_extra_the_error_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dask", None)
    context = WorkerContext(parameters=PipelineParameters(), is_simulated=True)
    with pytest.raises(UsageError, match=r"extra \[cluster\].*requirements-cluster\.lock"):
        async with open_cluster("dask://127.0.0.1:9", context):
            pass


def test_the_commands_import_it_only_when_asked() -> None:
    code = (
        "import sys, service.commands.measure, service.commands.remeasure\n"
        "assert not {'dask', 'distributed', 'tornado'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-W", "ignore", "-c", code], check=True)


def test_a_digest_is_of_names_and_bytes(tmp_path: Path) -> None:
    digests = set()
    for number, files in enumerate(
        [{"a": b"12", "b": b"3"}, {"a": b"1", "b": b"23"}, {"a": b"12", "c": b"3"}]
    ):
        folder = tmp_path / f"{number}"
        folder.mkdir()
        for name, data in files.items():
            (folder / name).write_bytes(data)
        digests.add(cluster.digest_of(folder))
    assert len(digests) == 3
    shutil.copytree(tmp_path / "0", tmp_path / "copy")
    assert cluster.digest_of(tmp_path / "copy") == cluster.digest_of(tmp_path / "0")


@pytest.mark.parametrize("name", ["bundle", "background", "rig.json"])
def test_a_path_that_is_not_shared_is_named(tmp_path: Path, name: str) -> None:
    write_small_recording(tmp_path / "recording", n_stones=2)
    _, _, first, second = open_recording(tmp_path / "recording").headers
    rig_path, background = tmp_path / "recording" / "rig.json", tmp_path / "background"
    background.mkdir()
    (background / "c01").write_bytes(b"1")
    job = MeasureJob(
        bundle_path=first.path,
        camera_ids=tuple(first.frames),
        rig_file=RigFile(rig_path, "0"),
        background_path=background,
        out_dir=tmp_path / "out",
    )
    digests = {path: cluster.digest_of(path) for path in (rig_path, background)}
    task = ClusterJob(job=job, header=first, digests=digests)
    assert cluster._unshared(task, cluster.digest_of) is None
    path = {"bundle": first.path, "background": background, "rig.json": rig_path}[name]
    file = path / "c01" if path.is_dir() else path
    for change in (lambda: file.write_bytes(second.path.read_bytes()), file.unlink):
        change()
        told = cluster._unshared(task, cluster.digest_of)
        assert told is not None and told.startswith(
            f"{path} is missing there, or another file: share its folder"
        )


def test_a_worker_that_would_measure_otherwise_or_cannot_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    assert cluster._trouble(installed_versions()) is None
    assert "numpy" in installed_versions()
    told = cluster._trouble({**installed_versions(), "algorithm": "0"})
    assert told is not None and "instead of 0" in told
    monkeypatch.setitem(multiprocessing.current_process()._config, "daemon", True)  # type: ignore[attr-defined]
    told = cluster._trouble(installed_versions())
    assert told is not None and "--no-nanny" in told
