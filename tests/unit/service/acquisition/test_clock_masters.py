"""Clocks of the cameras are judged for the rig: one master among slaves is right, several are not."""

from typing import cast

import pytest

from drivers.interfaces import Camera, CameraVitals
from pipeline.frames import CameraId
from service.acquisition.rig_cameras import RigCameras
from service.base.messages import Code, findings_of
from service.base.status import DeviceState


class Silent:
    """A camera that is only asked how it is."""

    def examine(self) -> CameraVitals:
        return CameraVitals()


def rig_of(*cameras: tuple[DeviceState, str | None]) -> RigCameras:
    """Return a rig of cameras in these states, whose clocks say this of themselves."""
    names = [CameraId(f"c{number:02d}") for number in range(1, len(cameras) + 1)]
    rig = RigCameras({name: cast(Camera, Silent()) for name in names})
    for name, (state, clock) in zip(names, cameras, strict=True):
        keeper = rig._cameras[name].keeper
        keeper.state, keeper.vitals = state, CameraVitals(ptp_status=clock)
    return rig


@pytest.mark.parametrize(
    ("clocks", "masters"),
    [
        (["Master", "Slave", "Slave"], []),
        (["Slave", "Slave", "Slave"], []),  # the master is a switch or this machine
        ([None, None, "Master"], []),
        (["Master", "Slave", "Master"], ["c01", "c03"]),
        (["Master", "Master", "Master"], ["c01", "c02", "c03"]),
    ],
)
def test_several_masters_are_named_at_each_of_them(clocks: list[str | None], masters: list[str]) -> None:
    rig = rig_of(*((DeviceState.ARMED, clock) for clock in clocks))
    warned = {status.id: status.warnings for status in rig.statuses() if status.warnings}
    assert sorted(warned) == masters
    for (warning,) in warned.values():
        (finding,) = findings_of(warning)
        assert (finding.code, finding.parameters) == (Code.CLOCK_MASTERS, {"masters": ", ".join(masters)})
        assert "there must be one" in warning


def test_a_camera_that_is_lost_is_no_master() -> None:
    rig = rig_of((DeviceState.ARMED, "Master"), (DeviceState.LOST, "Master"))
    assert all(status.warnings == () for status in rig.statuses())
