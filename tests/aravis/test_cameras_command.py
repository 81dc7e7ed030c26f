"""`stonefall cameras`: finds, lists, dumps."""

import json
from collections.abc import Iterator
from dataclasses import asdict

import pytest
import typer
from support.gige import INTERFACE, NET, design, place, powered, serial, settings_for
from typer.testing import CliRunner, Result

from drivers.cameras import description
from drivers.cameras.aravis import AravisCamera
from drivers.cameras.description import genicam_xml
from drivers.errors import CameraUnavailableError
from drivers.gvcp import probe
from service.commands.cameras import command


@pytest.fixture(autouse=True)
def two_cameras() -> Iterator[None]:
    with powered(design(2)), powered(design(3, dialect="legacy")):
        yield


def cameras(*arguments: str) -> Result:
    app = typer.Typer()
    app.command()(command)
    return CliRunner().invoke(app, list(arguments))


def test_a_table_for_people() -> None:
    result = cameras("--interface", INTERFACE)
    assert result.exit_code == 0
    for text in (f"{NET}.2", f"{NET}.3", serial(2), serial(3), place(2), "SF-1280"):
        assert text in result.stdout


def test_a_list_for_programs() -> None:
    result = cameras("--json", "--interface", INTERFACE, "--interface", "127.0.0.1")
    assert result.exit_code == 0
    ours = [camera for camera in json.loads(result.stdout) if camera["address"].startswith(f"{NET}.")]
    devices = [probe(f"{NET}.{number}") for number in (2, 3)]
    assert ours == [asdict(device) for device in devices if device is not None]
    assert len(ours) == 2


def test_the_features_of_one() -> None:
    result = cameras("--xml", f"{NET}.3")
    assert result.exit_code == 0
    assert "ExposureTimeAbs" in result.stdout
    assert result.stdout.rstrip().endswith("</RegisterDescription>")


def test_a_zipped_description_of_a_camera_in_use() -> None:
    zipped = design(4, has_zipped_xml=True)
    with powered(zipped) as simulated:
        camera = AravisCamera(settings_for(zipped))
        camera.open()
        owner = simulated.controller
        simulated.faults.control_loss = 0.02
        assert genicam_xml(f"{NET}.4").endswith("</RegisterDescription>")
        simulated.faults.clear()
        assert simulated.controller == owner
        camera.close()


@pytest.mark.parametrize(("is_zipped", "limit"), [(False, 100), (True, 100), (True, 6000)])
def test_a_description_without_bounds_is_not_read(
    monkeypatch: pytest.MonkeyPatch, is_zipped: bool, limit: int
) -> None:
    monkeypatch.setattr(description, "MAX_XML_BYTES", limit)
    with (
        powered(design(4, has_zipped_xml=is_zipped)),
        pytest.raises(CameraUnavailableError, match=f"more than {limit}"),
    ):
        genicam_xml(f"{NET}.4")


@pytest.mark.parametrize("arguments", [("--xml", "somewhere"), ("--interface", "eth0")])
def test_what_is_no_address_is_wrong_usage(arguments: tuple[str, ...]) -> None:
    assert cameras(*arguments).exit_code == 2


def test_what_cannot_be_done_is_an_error_with_its_reason() -> None:
    assert isinstance(error := cameras("--xml", f"{NET}.7").exception, CameraUnavailableError)
    assert str(error) == f"camera at {NET}.7: does not give its GenICam XML: [Errno 111] Connection refused"
    assert isinstance(error := cameras("--interface", "198.51.100.7").exception, OSError)
    assert "198.51.100.7" in str(error)
