import asyncio
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.acquisition import CAMERAS, DELAY_NS, UTC, AcquisitionBench, armed
from support.eventually import PATIENCE_S
from support.recordings import SIZE_PX, small_rig

from drivers.errors import GateUnavailableError
from drivers.factory import ReplayBackend, build_devices
from drivers.faulty.faults import Fault, FaultPlan
from drivers.faulty.gate import FaultyGate
from drivers.files.recording import RecordingSource, RecordingWriter
from drivers.interfaces import CameraLost, LightGate
from pipeline.frames import Frame, FrameBundle, Trigger
from service.acquisition import device_keeper
from service.acquisition.rig_cameras import RigCameras
from service.base.status import AcquisitionState, AcquisitionTarget, ConflictError
from service.bundling.frame_account import BundlingCounters, CameraCounters

N_BUNDLES = 6


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("acquisition") / "recording"
    source = RecordingSource(camera_ids=CAMERAS, rig=small_rig(CAMERAS), is_simulated=True)
    with RecordingWriter(path, source, made_by={}) as writer:
        for number in range(1, N_BUNDLES + 1):
            at_ns = number * 250_000_000
            frames = {
                camera: Frame(
                    camera=camera,
                    image=np.full(SIZE_PX[::-1], number, np.uint8),
                    frame_id=number,
                    device_ns=0,
                    received_ns=at_ns + DELAY_NS,
                )
                for camera in CAMERAS
            }
            trigger = Trigger(sequence=number, received_ns=at_ns, device_ns=0, utc=UTC, name=f"s{number}")
            writer.add(FrameBundle(trigger=trigger, frames=frames))
    return path


class Bench(AcquisitionBench):
    """An acquisition on a replayed recording."""

    def __init__(
        self,
        recording: Path,
        *,
        faults: FaultPlan | None = None,
        gate_faults: FaultPlan | None = None,
        min_cameras: int = 2,
    ) -> None:
        devices = build_devices(ReplayBackend(recording=recording, pace="stepped", faults=faults))
        if gate_faults is not None:  # here and not above: a swallowed trigger shall keep its permit
            devices = replace(devices, gate=FaultyGate(devices.gate, gate_faults))
        super().__init__(devices, min_cameras=min_cameras)

    async def step(self, n_bundles: int = 1) -> None:
        """Let so many more stones fall and wait for their bundles."""
        wanted = len(self.bundles) + n_bundles
        assert self.devices.belt is not None
        self.devices.belt.permit(n_bundles)
        await self.until(lambda: len(self.bundles) >= wanted)

    def state_of(self, camera: str) -> str:
        return next(status.state for status in self.acquisition.cameras.statuses() if status.id == camera)


async def test_every_trigger_is_recorded_before_its_bundle_until_the_recording_ends(recording: Path):
    bench = Bench(recording)
    async with armed(bench) as acquisition:
        assert acquisition.state is AcquisitionState.ARMED
        await bench.step(N_BUNDLES)
        await bench.until(lambda: acquisition.state is AcquisitionState.DISARMED)
    names = [f"s{number}" for number in range(1, N_BUNDLES + 1)]
    assert [bundle.name for bundle in bench.bundles] == names
    assert all(bundle.frames.keys() == set(CAMERAS) for bundle in bench.bundles)
    for name in names:
        assert bench.told.index(("trigger", name)) < bench.told.index(("bundle", name))
    assert [status.frames for status in bench.acquisition.cameras.statuses()] == [N_BUNDLES] * 3


async def test_disarmed_and_armed_again_no_stone_is_missed_or_doubled(recording: Path):
    bench = Bench(recording)
    async with armed(bench) as acquisition:
        await bench.step(2)
        assert acquisition.request(AcquisitionTarget.DISARMED) is AcquisitionState.DISARMING
        with pytest.raises(ConflictError):
            acquisition.request(AcquisitionTarget.ARMED)
        await bench.until(lambda: acquisition.state is AcquisitionState.DISARMED)
        assert {status.state for status in acquisition.cameras.statuses()} == {"closed"}
        acquisition.request(AcquisitionTarget.ARMED)
        await bench.until(lambda: acquisition.state is AcquisitionState.ARMED)
        await bench.step(2)
    assert [bundle.name for bundle in bench.bundles] == ["s1", "s2", "s3", "s4"]
    assert acquisition.state is AcquisitionState.STOPPING
    with pytest.raises(ConflictError):
        acquisition.request(AcquisitionTarget.ARMED)


async def test_disarming_before_the_rig_has_begun_to_arm_wins(recording: Path):
    bench = Bench(recording)
    acquisition = bench.acquisition
    acquisition.request(AcquisitionTarget.ARMED)
    assert acquisition.request(AcquisitionTarget.DISARMED) is AcquisitionState.DISARMING
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(acquisition.run())
        await asyncio.wait_for(acquisition.settled.wait(), PATIENCE_S)
        assert acquisition.state is AcquisitionState.DISARMED
        acquisition.request(AcquisitionTarget.ARMED)
        await bench.until(lambda: acquisition.state is AcquisitionState.ARMED)
        acquisition.stop()
        await running


async def test_it_is_active_as_long_as_devices_are_in_use(recording: Path):
    bench = Bench(recording)
    acquisition = bench.acquisition
    assert not acquisition.is_active
    async with armed(bench):
        assert acquisition.is_active
        acquisition.request(AcquisitionTarget.DISARMED)
        assert acquisition.is_active
        await bench.until(lambda: acquisition.state is AcquisitionState.DISARMED)
        assert not acquisition.is_active
        acquisition.request(AcquisitionTarget.ARMED)
        await bench.until(lambda: acquisition.is_active)
        acquisition.stop()
        assert acquisition.is_active
    assert not acquisition.is_active


def test_the_counters_of_all_armed_periods_add_up(recording: Path):
    cameras = RigCameras(Bench(recording).devices.cameras)
    for n_lost in (1, 2, 3):
        counters = BundlingCounters(cameras={camera: CameraCounters() for camera in CAMERAS})
        cameras.use_counters(counters)
        counters.cameras[CAMERAS[1]].lost += n_lost
    assert [status.lost for status in cameras.statuses()] == [0, 6, 0]


async def test_triggers_without_any_image_blame_the_line_only_while_the_cameras_answer(recording: Path):
    bench = Bench(recording)
    trigger = Trigger(sequence=1, received_ns=0, device_ns=0, utc="", name="dark")
    dark = FrameBundle(trigger=trigger, frames={}, missing=dict.fromkeys(CAMERAS, "no_frame"))
    async with armed(bench) as acquisition:
        for n_triggers in (1, 2, 3):
            acquisition.cameras.check_bundle(dark)
            assert acquisition.cameras.blind_triggers == n_triggers
        for camera in CAMERAS:
            acquisition.cameras.track(CameraLost(camera=camera, received_ns=0, reason="does not answer"))
        acquisition.cameras.check_bundle(dark)
        assert acquisition.cameras.blind_triggers == 0


async def test_a_stone_in_the_air_gets_its_bundle_when_stopping(recording: Path):
    bench = Bench(recording)
    async with armed(bench):
        assert bench.devices.belt is not None
        bench.devices.belt.permit(1)
        await bench.until(lambda: bench.told == [("trigger", "s1")] or len(bench.bundles) == 1)
    assert [bundle.name for bundle in bench.bundles] == ["s1"]
    assert bench.bundles[0].frames.keys() == set(CAMERAS)


async def test_a_lost_camera_degrades_and_comes_back(recording: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(device_keeper, "BACK_OFF_S", (0.2,))
    faults = FaultPlan(cameras=frozenset({CAMERAS[1]}), disconnect=Fault(at=frozenset({1})))
    bench = Bench(recording, faults=faults)
    async with armed(bench) as acquisition:
        await bench.step(2)
        assert bench.bundles[1].missing == {CAMERAS[1]: "camera_lost"}
        assert acquisition.state is AcquisitionState.ARMED
        lost = acquisition.cameras.statuses()[1]
        assert (lost.state, lost.last_error) == ("lost", "disconnected")
        await bench.until(lambda: bench.state_of("c02") == "armed")
        await bench.step(1)
    assert bench.bundles[2].frames.keys() == set(CAMERAS)


async def test_too_few_cameras_hold_the_acquisition_until_they_are_back(
    recording: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(device_keeper, "BACK_OFF_S", (0.5,))
    faults = FaultPlan(cameras=frozenset(CAMERAS[:2]), disconnect=Fault(at=frozenset({0})))
    bench = Bench(recording, faults=faults)
    async with armed(bench) as acquisition:
        await bench.step(1)
        await bench.until(lambda: acquisition.state is AcquisitionState.HELD)
        assert acquisition.trouble == "c01, c02: disconnected; cameras armed: 1, needed: 2"
        await bench.step(1)  # counted all the same
        await bench.until(lambda: acquisition.state is AcquisitionState.ARMED)
        assert acquisition.trouble is None
        await bench.until(
            lambda: acquisition.cameras.armed == len(CAMERAS)
        )  # two of them are enough for the state
        await bench.step(1)
        assert acquisition.request(AcquisitionTarget.DISARMED) is AcquisitionState.DISARMING
        await bench.until(lambda: acquisition.state is AcquisitionState.DISARMED)
    assert [len(bundle.frames) for bundle in bench.bundles] == [1, 1, 3]


async def test_a_store_that_is_held_holds_the_acquisition_and_stones_are_still_counted(recording: Path):
    bench = Bench(recording)
    async with armed(bench) as acquisition:
        await bench.step(1)
        bench.trouble = "database or disk is full: make room"
        await bench.until(lambda: acquisition.state is AcquisitionState.HELD)
        assert acquisition.status().trouble == f"store: {bench.trouble}"
        await bench.step(1)
        bench.trouble = None
        await bench.until(lambda: acquisition.state is AcquisitionState.ARMED)
        assert acquisition.status().trouble is None
    assert len(bench.bundles) == 2
    state = AcquisitionState
    assert bench.entered == [
        (state.ARMING, None),
        (state.ARMED, None),
        (state.HELD, "store: database or disk is full: make room"),
        (state.ARMED, None),
        (state.STOPPING, None),
    ]


async def test_a_lost_gate_holds_and_comes_back_while_the_cameras_stay_armed(
    recording: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(device_keeper, "BACK_OFF_S", (0.2,))
    bench = Bench(recording, gate_faults=FaultPlan(disconnect_gate=Fault(at=frozenset({1}))))
    async with armed(bench) as acquisition:
        await bench.step(1)
        assert bench.devices.belt is not None
        bench.devices.belt.permit(1)  # swallowed by the gate's failure
        await bench.until(lambda: bench.states[-1] is AcquisitionState.HELD)
        assert (acquisition.status().gate, acquisition.status().gate_error) == ("lost", "disconnected")
        assert {bench.state_of(camera) for camera in CAMERAS} == {"armed"}
        await bench.until(lambda: acquisition.state is AcquisitionState.ARMED)
        await bench.step(1)
        assert acquisition.trouble is None
    assert [bundle.name for bundle in bench.bundles if bundle.trigger.is_announced] == ["s1", "s3"]


class DeadGate:
    """Does not answer, at first."""

    def __init__(self, gate: LightGate, n_attempts: int) -> None:
        self.gate = gate
        self.n_attempts = n_attempts
        self.arm, self.test_pulse, self.disarm, self.close = (
            gate.arm,
            gate.test_pulse,
            gate.disarm,
            gate.close,
        )

    warnings: tuple[str, ...] = ()

    def open(self) -> None:
        self.n_attempts -= 1
        if self.n_attempts >= 0:
            raise GateUnavailableError("ttyUSB0", "no such device")
        self.gate.open()


async def test_a_gate_that_does_not_answer_holds_until_it_does(
    recording: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    monkeypatch.setattr(device_keeper, "BACK_OFF_S", (0.05,))
    bench = Bench(recording)
    bench.devices = replace(bench.devices, gate=(gate := DeadGate(bench.devices.gate, 3)))
    bench.make_acquisition()
    async with armed(bench) as acquisition:
        assert acquisition.state is AcquisitionState.HELD
        assert acquisition.trouble == "ttyUSB0: no such device"
        await bench.until(lambda: acquisition.state is AcquisitionState.ARMED)
        await bench.step(1)
    assert gate.n_attempts == -1
    alarms = [
        record.message
        for record in caplog.records
        if record.levelname in ("ERROR", "WARNING") and "stood still" not in record.message  # this host may
    ]
    assert alarms == [
        "device lost: ttyUSB0: no such device device=light gate",
        "acquisition held: ttyUSB0: no such device",
    ]


async def test_the_latest_frame_of_a_camera(recording: Path):
    bench = Bench(recording)
    async with armed(bench) as acquisition:
        assert acquisition.cameras.latest_image(CAMERAS[0]) is None
        await bench.step(2)
        image = acquisition.cameras.latest_image(CAMERAS[0])
    assert image is not None
    assert image.dtype == np.uint8
