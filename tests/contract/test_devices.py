"""What every camera and every light gate does, whatever it is made of."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.pty_gate import serial_gate
from support.recordings import CAMERAS, make_bundle, tagged_image, write_recording
from support.sinks import Collector

from drivers.errors import DeviceError
from drivers.factory import Devices, ReplayBackend, build_devices
from drivers.faults import FaultPlan
from drivers.interfaces import Camera, LightGate
from pipeline.frames import Frame, Trigger

N_BUNDLES = 12
PLANS = {"replay": None, "faulty": FaultPlan(seed=1)}


@dataclass(frozen=True)
class Bench:
    """A device under test, and a rig around it that can be made to expose."""

    devices: Devices
    witness: Collector
    """Sees every exposure after all other cameras, on the last camera."""
    triggers: Collector
    fire: Callable[[], None]
    """One stone falls; returns when it is over."""


@pytest.fixture(params=PLANS)
def devices(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Devices]:
    path = write_recording(tmp_path / "rec", [make_bundle(number) for number in range(N_BUNDLES)])
    devices = build_devices(ReplayBackend(recording=path, pace="stepped", faults=PLANS[request.param]))
    yield devices
    devices.gate.close()
    for camera in devices.cameras.values():
        camera.close()


@pytest.fixture
def bench(devices: Devices) -> Bench:
    witness, triggers = Collector(), Collector()
    last = devices.cameras[CAMERAS[-1]]
    last.open()
    last.arm(witness)
    devices.gate.open()
    devices.gate.arm(triggers)
    belt = devices.belt
    assert belt is not None

    def fire() -> None:
        belt.step()
        assert isinstance(witness.next(), Frame)

    return Bench(devices, witness, triggers, fire)


class TestCameraContract:
    @pytest.fixture
    def camera(self, devices: Devices) -> Camera:
        return devices.cameras[CAMERAS[0]]

    def test_it_knows_its_place(self, camera: Camera) -> None:
        assert camera.id == CAMERAS[0]

    def test_an_armed_camera_delivers_every_exposure(self, camera: Camera, bench: Bench) -> None:
        sink = Collector()
        camera.open()
        camera.arm(sink)
        for _ in range(3):
            bench.fire()
        frames = sink.events
        assert len(frames) == 3
        for number, frame in enumerate(frames):
            assert isinstance(frame, Frame)
            assert frame.camera == camera.id
            assert np.array_equal(frame.image, tagged_image(number, camera.id))
            assert not frame.image.flags.writeable
        assert all(b.frame_id - a.frame_id == 1 for a, b in pairwise(frames))
        assert all(b.received_ns > a.received_ns and b.device_ns > a.device_ns for a, b in pairwise(frames))

    def test_after_disarm_nothing_is_delivered(self, camera: Camera, bench: Bench) -> None:
        sink, second_sink = Collector(), Collector()
        camera.open()
        camera.arm(sink)
        bench.fire()
        camera.disarm()
        camera.disarm()
        bench.fire()
        assert len(sink.events) == 1
        camera.arm(second_sink)
        bench.fire()
        assert len(sink.events) == 1
        assert [frame.frame_id for frame in second_sink.events] == [sink.events[0].frame_id + 2]

    def test_disarming_is_final_at_any_moment(self, camera: Camera, bench: Bench) -> None:
        camera.open()
        assert bench.devices.belt is not None
        bench.devices.belt.permit(N_BUNDLES)
        sinks = []
        while len(bench.witness.events) < N_BUNDLES:
            camera.arm(sink := Collector())
            bench.witness.next()
            camera.disarm()
            sinks.append((sink, len(sink.events)))
        assert all(len(sink.events) == n_when_disarmed for sink, n_when_disarmed in sinks)

    def test_a_sink_that_refuses_does_not_stop_it(self, camera: Camera, bench: Bench) -> None:
        camera.open()
        camera.arm(sink := Collector(accepts=False))
        bench.fire()
        bench.fire()
        assert len(sink.events) == 2

    def test_it_must_be_open_to_be_armed(self, camera: Camera) -> None:
        with pytest.raises(DeviceError, match=camera.id):
            camera.arm(Collector())
        camera.open()
        camera.close()
        with pytest.raises(DeviceError, match=camera.id):
            camera.arm(Collector())

    def test_closing_is_always_allowed(self, camera: Camera, bench: Bench) -> None:
        camera.close()
        camera.open()
        camera.close()
        camera.close()
        camera.disarm()
        camera.open()
        camera.arm(sink := Collector())
        bench.fire()
        camera.close()
        bench.fire()
        assert len(sink.events) == 1


@dataclass(frozen=True)
class GateBench:
    """A gate under test, closed, and a way to let stones fall through it."""

    gate: LightGate
    drop: Callable[[], None]
    """One stone passes; who listens hears of it soon."""
    clock: Callable[[], int] = time.monotonic_ns


@pytest.fixture(params=[*PLANS, "serial"])
def gate_bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[GateBench]:
    if request.param == "serial":
        with serial_gate(tmp_path / "gate") as (gate, device):
            yield GateBench(gate, device.edge)
        return
    path = write_recording(tmp_path / "rec", [make_bundle(number) for number in range(N_BUNDLES)])
    devices = build_devices(ReplayBackend(recording=path, pace="stepped", faults=PLANS[request.param]))
    assert devices.belt is not None
    yield GateBench(devices.gate, devices.belt.step, devices.clock)
    devices.gate.close()


class TestGateContract:
    @pytest.fixture
    def gate(self, gate_bench: GateBench) -> LightGate:
        return gate_bench.gate

    def test_an_armed_gate_counts_stones(self, gate: LightGate, gate_bench: GateBench) -> None:
        gate.open()
        gate.arm(sink := Collector())
        triggers, before_ns = [], gate_bench.clock()
        for _ in range(3):
            gate_bench.drop()
            triggers.append(next_trigger(sink))
        assert all(later.sequence - earlier.sequence == 1 for earlier, later in pairwise(triggers))
        assert all(later.received_ns > earlier.received_ns for earlier, later in pairwise(triggers))
        assert before_ns <= triggers[1].received_ns <= gate_bench.clock()
        assert all(trigger.utc.endswith("Z") for trigger in triggers)

    def test_after_disarm_nothing_is_delivered(self, gate: LightGate, gate_bench: GateBench) -> None:
        gate.open()
        gate.arm(sink := Collector())
        gate_bench.drop()
        first = next_trigger(sink)
        gate.disarm()
        gate.disarm()
        gate_bench.drop()
        gate.arm(second_sink := Collector())
        gate_bench.drop()
        assert next_trigger(second_sink).sequence > first.sequence
        assert len(sink.events) == 1

    def test_it_must_be_open_to_be_armed(self, gate: LightGate) -> None:
        with pytest.raises(DeviceError, match="gate"):
            gate.arm(Collector())

    def test_closing_is_always_allowed_and_it_can_be_opened_again(
        self, gate: LightGate, gate_bench: GateBench
    ) -> None:
        gate.open()
        gate.arm(sink := Collector())
        gate_bench.drop()
        first = next_trigger(sink)
        gate.close()
        gate.close()
        gate.disarm()
        gate.open()
        gate.arm(second_sink := Collector())
        gate_bench.drop()
        assert next_trigger(second_sink).sequence == first.sequence + 1
        assert len(sink.events) == 1

    def test_closing_unopened(self, gate: LightGate) -> None:
        gate.close()
        gate.disarm()


def next_trigger(sink: Collector) -> Trigger:
    trigger = sink.next()
    assert isinstance(trigger, Trigger)
    return trigger
