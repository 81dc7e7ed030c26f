"""Clocks of the cameras are judged for the rig: one master among slaves is right, several are not."""

import pytest

from drivers.interfaces import CameraVitals
from pipeline.frames import CameraId
from service.acquisition.rig_cameras import RigCameras
from service.base.messages import Code, findings_of
from service.base.status import DeviceState


class Silent:
    """A camera that is only asked how it is."""

    def examine(self) -> CameraVitals:
        return CameraVitals()


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
    names = [CameraId(f"c{number:02d}") for number in range(1, len(clocks) + 1)]
    rig = RigCameras({name: Silent() for name in names})  # type: ignore[dict-item] # not opened here
    for name, clock in zip(names, clocks, strict=True):
        keeper = rig._cameras[name].keeper
        keeper.state, keeper.vitals = DeviceState.ARMED, CameraVitals(ptp_status=clock)
    warned = {status.id: status.warnings for status in rig.statuses() if status.warnings}
    assert sorted(warned) == masters
    for (warning,) in warned.values():
        (finding,) = findings_of(warning)
        assert (finding.code, finding.parameters) == (Code.CLOCK_MASTERS, {"masters": ", ".join(masters)})
        assert "there must be one" in warning


def test_a_camera_that_is_lost_is_no_master() -> None:
    names = [CameraId("c01"), CameraId("c02")]
    rig = RigCameras({name: Silent() for name in names})  # type: ignore[dict-item] # not opened here
    for name, state in zip(names, (DeviceState.ARMED, DeviceState.LOST), strict=True):
        keeper = rig._cameras[name].keeper
        keeper.state, keeper.vitals = state, CameraVitals(ptp_status="Master")
    assert all(status.warnings == () for status in rig.statuses())
