"""What every camera and every light gate does, whatever it is made of."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.bare_lines import FakeLine, FakeLines
from support.eventually import eventually
from support.gige import gige_rig
from support.pty_gate import pty_settings, serial_gate
from support.recordings import CAMERAS, make_bundle, tagged_image, write_recording
from support.sinks import Collector

from drivers.camera_process.process import CameraProcess
from drivers.errors import CameraUnavailableError, GateUnavailableError
from drivers.factory import ARAVIS, Devices, ReplayBackend, build_devices
from drivers.faulty.faults import FaultPlan
from drivers.gates.firing import FiringGate
from drivers.gates.gpio import ECHO_NS, GpioGate, GpioGateSettings
from drivers.gates.modem_line import ModemLineGate, ModemLineSettings
from drivers.gates.serial_gate import SerialGate
from drivers.gige_simulator.gate import GateDesign, SimulatedGate
from drivers.interfaces import Camera, CameraVitals, LightGate
from pipeline.frames import BundleKind, CameraId, Frame, Trigger

N_BUNDLES = 12
STAYS_NS = 60_000_000_000
"""A stone closes the beam for longer than a test takes: the end of its pulse is not waited for."""
DELAY_US = 300_000
PLANS = {"replay": None, "faulty": FaultPlan(seed=1)}


@dataclass(frozen=True)
class Bench:
    """Cameras under test, closed, in a rig that can be made to expose."""

    cameras: Mapping[CameraId, Camera]
    drop: Callable[[], None]
    """One stone falls; returns at once. Stone n shows `tagged_image(n, camera)`, from 0."""
    is_counting_on: bool
    """Whether frame ids go on while a camera is disarmed; otherwise they begin anew when it is armed."""
    lit: Callable[[], tuple[int, bool]] | None = None
    """How often the first camera's lamp was lit by a host, and whether it shines; None: it has none."""
    witness: Collector = field(default_factory=Collector)
    """Of the last camera; sees every exposure."""

    def fire(self) -> None:
        """One stone falls; returns when the witness has seen it."""
        self.drop()
        assert isinstance(self.witness.next(), Frame)


@pytest.fixture(params=[*PLANS, "aravis", "aravis in a process of its own"])
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    is_live = request.param.startswith("aravis")
    with aravis_bench(request.param) if is_live else replayed_bench(tmp_path, request.param) as bench:
        witnessing = bench.cameras[CAMERAS[-1]]
        witnessing.open()
        witnessing.arm(bench.witness)
        yield bench


@contextmanager
def replayed_bench(folder: Path, plan: str) -> Iterator[Bench]:
    devices = replayed_devices(folder, plan)
    assert devices.belt is not None
    devices.gate.open()
    devices.gate.arm(Collector())
    yield Bench(devices.cameras, devices.belt.step, is_counting_on=True)
    devices.gate.close()
    for camera in devices.cameras.values():
        camera.close()


@contextmanager
def aravis_bench(where: str) -> Iterator[Bench]:
    process = None if where == "aravis" else CameraProcess(ARAVIS)
    with gige_rig(CAMERAS, process) as rig:
        first = rig.simulated[CAMERAS[0]]
        yield Bench(
            rig.cameras, rig.fire, is_counting_on=False, lit=lambda: (first.counters.blinks, first.is_lit)
        )
    if process is not None:
        process.close()


def replayed_devices(folder: Path, plan: str) -> Devices:
    path = write_recording(folder / "rec", [make_bundle(number) for number in range(N_BUNDLES)])
    return build_devices(ReplayBackend(recording=path, pace="stepped", faults=PLANS[plan]))


class TestCameraContract:
    @pytest.fixture
    def camera(self, bench: Bench) -> Camera:
        return bench.cameras[CAMERAS[0]]

    def test_it_knows_its_place(self, camera: Camera) -> None:
        assert camera.id == CAMERAS[0]

    def test_an_armed_camera_delivers_every_exposure(self, camera: Camera, bench: Bench) -> None:
        camera.open()
        camera.arm(sink := Collector())
        frames = []
        for number in range(3):
            bench.fire()
            frames.append(frame := next_frame(sink))
            assert frame.camera == camera.id
            assert np.array_equal(frame.image, tagged_image(number, camera.id))
            assert not frame.image.flags.writeable
        assert all(b.frame_id - a.frame_id == 1 for a, b in pairwise(frames))
        assert all(b.received_ns > a.received_ns and b.device_ns > a.device_ns for a, b in pairwise(frames))
        assert len(sink.events) == 3

    def test_after_disarm_nothing_is_delivered(self, camera: Camera, bench: Bench) -> None:
        camera.open()
        camera.arm(sink := Collector())
        bench.fire()
        first = next_frame(sink)
        camera.disarm()
        camera.disarm()
        bench.fire()
        camera.arm(second_sink := Collector())
        bench.fire()
        third = next_frame(second_sink)
        assert third.frame_id == (first.frame_id + 2 if bench.is_counting_on else first.frame_id)
        assert np.array_equal(third.image, tagged_image(2, camera.id))
        assert (len(sink.events), len(second_sink.events)) == (1, 1)

    def test_disarming_is_final_at_any_moment(self, camera: Camera, bench: Bench) -> None:
        camera.open()
        sinks = []
        for number in range(N_BUNDLES):
            camera.arm(sink := Collector())
            bench.drop()
            threading.Event().wait(number * 0.5e-3)  # while the frame is on its way, or just here
            camera.disarm()
            sinks.append((sink, len(sink.events)))
            bench.witness.next()
        assert all(len(sink.events) == n_when_disarmed for sink, n_when_disarmed in sinks)

    def test_a_sink_that_refuses_does_not_stop_it(self, camera: Camera, bench: Bench) -> None:
        camera.open()
        camera.arm(sink := Collector(accepts=False))
        for _ in range(2):
            bench.fire()
            next_frame(sink)
        assert len(sink.events) == 2

    def test_it_must_be_open_to_be_armed(self, camera: Camera) -> None:
        with pytest.raises(CameraUnavailableError, match=camera.id):
            camera.arm(Collector())
        camera.open()
        camera.close()
        with pytest.raises(CameraUnavailableError, match=camera.id):
            camera.arm(Collector())

    def test_it_tells_how_it_is_while_it_is_open(self, camera: Camera, bench: Bench) -> None:
        with pytest.raises(CameraUnavailableError, match=camera.id):
            camera.examine()
        camera.open()
        assert camera.examine().frames == 0
        camera.arm(sink := Collector())
        bench.fire()
        next_frame(sink)
        vitals = camera.examine()
        assert isinstance(vitals, CameraVitals)
        assert (vitals.failed_frames, vitals.missing_packets) == (0, 0)
        camera.close()
        with pytest.raises(CameraUnavailableError, match=camera.id):
            camera.examine()

    def test_an_open_camera_lights_its_lamp_until_it_is_armed_or_closed(
        self, camera: Camera, bench: Bench
    ) -> None:
        with pytest.raises(CameraUnavailableError, match="is not open"):
            camera.light(is_on=True)
        camera.open()
        if bench.lit is None:
            with pytest.raises(CameraUnavailableError, match="has no lamp"):
                camera.light(is_on=True)
            return
        usual = bench.lit()
        for _ in range(2):
            camera.light(is_on=False)
            assert not bench.lit()[1]
            camera.light(is_on=True)
            assert bench.lit()[1]
        assert bench.lit()[0] - usual[0] >= 1
        camera.light(is_on=False)
        camera.arm(sink := Collector())
        assert bench.lit()[1] == usual[1]
        with pytest.raises(CameraUnavailableError, match="is armed"):
            camera.light(is_on=True)
        bench.fire()
        next_frame(sink)
        camera.disarm()
        camera.light(is_on=not usual[1])
        camera.close()
        assert bench.lit()[1] == usual[1]

    def test_closing_is_always_allowed(self, camera: Camera, bench: Bench) -> None:
        camera.close()
        camera.open()
        camera.close()
        camera.close()
        camera.disarm()
        camera.open()
        camera.arm(sink := Collector())
        bench.fire()
        next_frame(sink)
        camera.close()
        bench.fire()
        assert len(sink.events) == 1


def next_frame(sink: Collector) -> Frame:
    frame = sink.next()
    assert isinstance(frame, Frame)
    return frame


@dataclass(frozen=True)
class GateBench:
    """A gate under test, closed, and a way to let stones fall through it."""

    gate: LightGate
    drop: Callable[[], None]
    """One stone passes; who listens hears of it soon."""
    clock: Callable[[], int] = time.monotonic_ns
    can_expose: bool = True
    """Whether it can trigger the cameras without a stone."""
    pulses_ns: list[int] | None = None
    """When it pulsed the cameras, by the gate's own doing; None: nothing to see it by."""


@pytest.fixture(params=[*PLANS, "serial", "firing", "simulated", "delaying", "gpio", "modem line"])
def gate_bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[GateBench]:
    if request.param in PLANS:
        devices = replayed_devices(tmp_path, request.param)
        assert devices.belt is not None
        yield GateBench(devices.gate, devices.belt.step, devices.clock, can_expose=False)
        devices.gate.close()
        return
    with LIVE_GATES[request.param](tmp_path / "gate") as live:
        yield live
        live.gate.close()


@contextmanager
def simulated_bench(link: Path, *, delay_us: int = 0) -> Iterator[GateBench]:
    pulses_ns: list[int] = []
    simulated = SimulatedGate(GateDesign(link=link), pulse=pulses_ns.append, empty_rig=lambda _: None)
    simulated.open()
    yield GateBench(
        SerialGate(pty_settings(link), delay_us=delay_us),
        lambda: simulated.interrupt(time.monotonic_ns(), STAYS_NS),
        pulses_ns=pulses_ns,
    )
    simulated.close()


@contextmanager
def gpio_bench(_: Path) -> Iterator[GateBench]:
    settings = GpioGateSettings(chip="/dev/gpiochip9", line="gate", test_line=5, debounce_us=0)
    lines = FakeLines()

    def drop() -> None:
        time.sleep(2 * ECHO_NS / 1e9)  # no echo of a test pulse
        lines.edges((True, now_ns := time.monotonic_ns()), (False, now_ns))

    yield GateBench(GpioGate(settings, lambda _: lines), drop)


@contextmanager
def modem_line_bench(_: Path) -> Iterator[GateBench]:
    line = FakeLine()
    gate = ModemLineGate(ModemLineSettings(port="/dev/gate", debounce_us=0), lambda _: line)
    yield GateBench(gate, lambda: line.switch(times=2), can_expose=False)


@contextmanager
def serial_bench(link: Path, *, is_firing: bool = False) -> Iterator[GateBench]:
    with serial_gate(link) as (gate, device):
        yield GateBench(FiringGate(gate, lambda: None) if is_firing else gate, device.edge)


LIVE_GATES: Mapping[str, Callable[[Path], AbstractContextManager[GateBench]]] = {
    "serial": serial_bench,
    "firing": partial(serial_bench, is_firing=True),
    "simulated": simulated_bench,
    "delaying": partial(simulated_bench, delay_us=DELAY_US),
    "gpio": gpio_bench,
    "modem line": modem_line_bench,
}


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

    def test_stones_are_told_when_they_pass_however_late_their_pulses_are(
        self, gate: LightGate, gate_bench: GateBench
    ) -> None:
        gate.open()
        gate.arm(sink := Collector())
        triggers = []
        for _ in range(4):  # all in the air together, where the gate delays
            gate_bench.drop()
            triggers.append(next_trigger(sink))
        gate.close()
        if (pulses_ns := gate_bench.pulses_ns) is None:
            return
        eventually(lambda: len(pulses_ns) == len(triggers))
        spacings_ns = [later.device_ns - earlier.device_ns for earlier, later in pairwise(triggers)]
        assert [b - a for a, b in pairwise(pulses_ns)] == pytest.approx(spacings_ns, abs=5000)

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
        with pytest.raises(GateUnavailableError, match="gate"):
            gate.arm(Collector())

    def test_only_an_armed_gate_exposes_the_empty_rig(self, gate: LightGate, gate_bench: GateBench) -> None:
        with pytest.raises(GateUnavailableError, match="gate"):
            gate.test_pulse()
        gate.open()
        with pytest.raises(GateUnavailableError, match="gate"):
            gate.test_pulse()
        gate.arm(sink := Collector())
        if gate_bench.can_expose:
            before_ns = gate_bench.clock()
            gate.test_pulse()
            trigger = next_trigger(sink)
            assert trigger.kind is BundleKind.BACKGROUND
            assert before_ns <= trigger.received_ns <= gate_bench.clock()
        else:
            with pytest.raises(GateUnavailableError, match="gate"):
                gate.test_pulse()
        gate_bench.drop()
        assert next_trigger(sink).kind is BundleKind.PARTICLE
        gate.disarm()
        with pytest.raises(GateUnavailableError, match="gate"):
            gate.test_pulse()

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
