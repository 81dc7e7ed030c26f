"""What every camera and every light gate promises, run over all twins of the devices."""

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.collector import Collector
from support.recordings import CAMERAS, make_bundle, tagged_image, write_recording

from drivers.errors import CameraUnavailableError, GateUnavailableError
from drivers.factory import Devices, ReplayBackend, build_devices
from drivers.faults import FaultPlan
from drivers.interfaces import Camera, LightGate, PlaybackEnded
from pipeline.frames import Frame, Trigger

N_BUNDLES = 6


class Rig:
    """A rig of one backend, exposed on demand; closed at the end of the test."""

    def __init__(self, devices: Devices, expose: Callable[[int], None]) -> None:
        self.devices = devices
        self.camera: Camera = devices.cameras[CAMERAS[1]]
        self.gate: LightGate = devices.gate
        self.expose = expose


@pytest.fixture(params=["replay", "faulty"])
def rig(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Rig]:
    recording = write_recording(tmp_path / "r", [make_bundle(i) for i in range(1, N_BUNDLES + 1)])
    # the faulty twin without faults must be indistinguishable from what it wraps
    faults = FaultPlan(seed=1) if request.param == "faulty" else None
    devices = build_devices(ReplayBackend(recording=recording, pace="stepped", faults=faults))
    assert devices.belt is not None
    yield Rig(devices, devices.belt.permit)
    devices.gate.close()
    for camera in devices.cameras.values():
        camera.close()


class TestCamera:
    def test_delivers_a_frame_of_its_own_at_each_exposure(self, rig: Rig) -> None:
        frames = Collector()
        rig.camera.open()
        rig.camera.arm(frames)
        rig.gate.open()
        rig.gate.arm(Collector())
        rig.expose(3)
        frames.wait(lambda: len(frames.of(Frame)) == 3)
        for number, frame in enumerate(frames.of(Frame), start=1):
            assert frame.camera == rig.camera.id == CAMERAS[1]
            assert (frame.image == tagged_image(number, CAMERAS[1])).all()
            assert not frame.image.flags.writeable
        ids = [frame.frame_id for frame in frames.of(Frame)]
        times = [frame.received_ns for frame in frames.of(Frame)]
        assert ids == sorted(set(ids))
        assert times == sorted(set(times))
        assert times[-1] <= rig.devices.clock()

    def test_delivers_nothing_after_disarm_and_goes_on_when_armed_again(self, rig: Rig) -> None:
        before, after, triggers = Collector(), Collector(), Collector()
        rig.camera.open()
        rig.camera.arm(before)
        rig.gate.open()
        rig.gate.arm(triggers)
        rig.expose(1)
        before.wait(lambda: len(before.events) == 1)
        rig.camera.disarm()
        rig.expose(1)
        triggers.wait(lambda: len(triggers.of(Trigger)) == 2)
        rig.camera.arm(after)
        rig.expose(1)
        after.wait(lambda: len(after.of(Frame)) >= 1)
        assert len(before.events) == 1

    def test_close_is_allowed_in_every_state_and_twice(self, rig: Rig) -> None:
        rig.camera.close()
        rig.camera.open()
        rig.camera.close()
        rig.camera.close()
        rig.camera.open()
        rig.camera.arm(Collector())
        rig.camera.close()
        rig.camera.open()

    def test_cannot_be_armed_before_it_is_open(self, rig: Rig) -> None:
        with pytest.raises(CameraUnavailableError, match=CAMERAS[1]):
            rig.camera.arm(Collector())


class TestGate:
    def test_delivers_a_trigger_a_stone_in_order(self, rig: Rig) -> None:
        triggers = Collector()
        rig.gate.open()
        rig.gate.arm(triggers)
        rig.expose(N_BUNDLES)
        triggers.wait(lambda: bool(triggers.of(PlaybackEnded)))
        sequences = [trigger.sequence for trigger in triggers.of(Trigger)]
        assert sequences == list(range(1, N_BUNDLES + 1))
        times = [trigger.received_ns for trigger in triggers.of(Trigger)]
        # spaced as recorded, however fast it was played
        assert {b - a for a, b in itertools.pairwise(times)} == {250_000_000}

    def test_delivers_nothing_after_disarm_and_loses_no_stone_by_it(self, rig: Rig) -> None:
        before, after = Collector(), Collector()
        rig.gate.open()
        rig.gate.arm(before)
        rig.expose(2)
        before.wait(lambda: len(before.of(Trigger)) == 2)
        rig.gate.disarm()
        rig.expose(2)
        rig.gate.arm(after)
        after.wait(lambda: len(after.of(Trigger)) == 2)
        assert [trigger.sequence for trigger in before.of(Trigger)] == [1, 2]
        assert [trigger.sequence for trigger in after.of(Trigger)] == [3, 4]

    def test_close_is_allowed_in_every_state_and_twice(self, rig: Rig) -> None:
        rig.gate.close()
        rig.gate.open()
        rig.gate.arm(Collector())
        rig.gate.close()
        rig.gate.close()
        rig.gate.open()

    def test_cannot_be_armed_before_it_is_open(self, rig: Rig) -> None:
        with pytest.raises(GateUnavailableError):
            rig.gate.arm(Collector())
