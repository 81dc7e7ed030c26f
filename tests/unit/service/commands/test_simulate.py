"""`stonefall simulate` as a process."""

import json
import os
import signal
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import typer
from support.daemon_process import STONEFALL
from support.eventually import PATIENCE_S
from support.recordings import CAMERAS, make_bundle, write_recording

from drivers import gvcp
from pipeline.frames import BundleKind
from service.base.errors import UsageError
from service.commands import synthesize
from service.commands.simulate import command

FIRST_ADDRESS = f"127.34.{os.getpid() % 256}.2"


@pytest.fixture
def recording_path(tmp_path: Path) -> Path:
    return write_recording(
        tmp_path / "rec", [make_bundle(1, kind=BundleKind.BACKGROUND), make_bundle(2), make_bundle(3)]
    )


@contextmanager
def simulating(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    words = [str(STONEFALL), "simulate", *map(str, arguments)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with process:
        try:
            yield process
        finally:
            process.kill()


def read_line(process: subprocess.Popen[str]) -> dict[str, Any]:
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line, process.communicate()[1]
    document: dict[str, Any] = json.loads(line)
    return document


def asked(path: str, **fields: object) -> dict[str, Any]:
    with socket.socket(socket.AF_UNIX) as client, client.makefile("rw") as lines:
        client.connect(path)
        lines.write(json.dumps(fields) + "\n")
        lines.flush()
        answer: dict[str, Any] = json.loads(lines.readline())
        return answer


def test_it_says_what_is_there_and_ends_when_told(tmp_path: Path, recording_path: Path) -> None:
    gate, control = tmp_path / "gate", tmp_path / "control"
    options = ("--address", FIRST_ADDRESS, "--gate-link", gate, "--control", control, "--start", "manual")
    with simulating(recording_path, *options, "--json") as process:
        ready = read_line(process)
        assert [camera["id"] for camera in ready["cameras"]] == list(CAMERAS)
        assert (ready["gate"], ready["control"]) == (str(gate), str(control))
        for camera in ready["cameras"]:
            found = gvcp.probe(camera["address"], timeout_s=2.0)
            assert found is not None
            assert (found.serial, found.user_name) == (camera["serial"], camera["id"])
        os.close(os.open(gate, os.O_RDWR | os.O_NOCTTY))
        assert asked(ready["control"], do="state")["belt"]["is_running"] is False
        process.send_signal(signal.SIGTERM)
        assert read_line(process)["belt"]["stones"] == 0
        assert process.wait(PATIENCE_S) == 0
    assert not os.path.lexists(gate)
    assert not control.exists()


@pytest.mark.full
def test_once_through(recording_path: Path) -> None:
    with simulating(
        recording_path, "--address", FIRST_ADDRESS, "--cameras", 2, "--rate", 20, "--once", "--json"
    ) as process:
        ready = read_line(process)
        assert asked(ready["control"], do="start")["ok"]
        counters = read_line(process)
        assert process.wait(PATIENCE_S) == 0
    assert counters["belt"]["stones"] == 2
    assert counters["gate"]["edges"] == 2
    assert {camera: counted["edges"] for camera, counted in counters["cameras"].items()} == {
        "c01": 3,
        "c02": 3,
    }
    assert not Path(ready["control"]).parent.exists()


def test_a_second_one_is_refused_in_one_line(recording_path: Path) -> None:
    with simulating(recording_path, "--address", FIRST_ADDRESS, "--json") as process:
        read_line(process)
        with simulating(recording_path, "--address", FIRST_ADDRESS) as second:
            _, complaint = second.communicate(timeout=PATIENCE_S)
        assert second.returncode == 1
        assert FIRST_ADDRESS in complaint
        assert len(complaint.splitlines()) == 1


@pytest.mark.parametrize("wrong", [{"address": "localhost"}, {"loop": True, "once": True}])
def test_wrong_usage(recording_path: Path, wrong: dict[str, Any]) -> None:
    with pytest.raises(typer.BadParameter):
        command(recording_path, **wrong)


def test_more_cameras_than_were_recorded(recording_path: Path) -> None:
    with pytest.raises(UsageError, match="has 4 cameras, not 99"):
        command(recording_path, cameras=99)


def test_a_folder_for_temporary_files_that_leads_elsewhere_is_not_trusted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(path: Path, **options: object) -> None:
        (path / "rendered").mkdir(parents=True)

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(synthesize, "command", nothing)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / f"stonefall-{os.getuid()}").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UsageError, match="nothing in it is trusted"):
        command(bodies="stones", count=1)
    assert list((tmp_path / "elsewhere").iterdir()) == []
