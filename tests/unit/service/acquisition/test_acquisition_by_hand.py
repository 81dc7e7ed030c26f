"""What is told late, in numbers or never, to an acquisition whose devices and clock are the test's."""

from collections.abc import Collection

import numpy as np
import pytest
from support.acquisition import CAMERAS, DELAY_NS, UTC, AcquisitionBench, armed

from drivers.factory import Devices
from drivers.interfaces import CameraLost, CameraVitals, EventSink, TriggersLost
from pipeline.frames import BundleKind, CameraId, Frame, GateCount, Trigger
from service.acquisition import device_keeper
from service.acquisition.rig_cameras import MAX_MISSES, MAX_RECENT_MISSES, RECENT_TRIGGERS
from service.base.status import AcquisitionState, AcquisitionTarget


class HandCamera:
    """Delivers what a test hands it."""

    def __init__(self, camera: CameraId) -> None:
        self.id = camera
        self.sink: EventSink | None = None

    def open(self) -> None: ...

    def arm(self, sink: EventSink) -> None:
        self.sink = sink

    def examine(self) -> CameraVitals:
        return CameraVitals()

    def disarm(self) -> None: ...

    def close(self) -> None: ...


class HandGate(HandCamera):
    warnings = ()

    def test_pulse(self) -> None: ...


class HandBench(AcquisitionBench):
    """What a test hands to the devices, at the time that it says it is."""

    def __init__(self, *, is_ball: bool = False) -> None:
        self.now_ns = 10**10
        self.cameras = {camera: HandCamera(camera) for camera in CAMERAS}
        self.gate = HandGate(CameraId("gate"))
        devices = Devices(cameras=self.cameras, gate=self.gate, clock=lambda: self.now_ns)
        super().__init__(devices, is_ball=lambda: is_ball)

    def trigger(self, sequence: int, at_ns: int) -> None:
        assert self.gate.sink is not None
        self.gate.sink.deliver(Trigger(sequence=sequence, received_ns=at_ns, device_ns=at_ns, utc=UTC))

    def expose(
        self, number: int, cameras: Collection[CameraId] = CAMERAS, exposed_ns: int | None = None
    ) -> None:
        image = np.full(
            (4, 4), number, np.uint8
        )  # an equal one would be refused as that of a camera that hangs
        for camera in cameras:
            device = self.cameras[camera]
            assert device.sink is not None
            device.sink.deliver(
                Frame(
                    camera=camera,
                    image=image,
                    frame_id=number,
                    device_ns=self.now_ns if exposed_ns is None else exposed_ns,
                    received_ns=self.now_ns,
                )
            )


@pytest.mark.parametrize("is_ball", [False, True])
async def test_a_line_that_is_read_late_is_of_the_stone_that_is_there_already(is_ball: bool):
    bench = HandBench(is_ball=is_ball)
    async with armed(bench) as acquisition:
        for number in (1, 2, 3):
            fell_ns = bench.now_ns
            if number != 2:
                bench.trigger(number, fell_ns)
                await bench.until(lambda n=number: len(bench.told) == 2 * n - 1)
            bench.now_ns += DELAY_NS
            bench.expose(number)
            bench.now_ns += DELAY_NS  # the deadline of the line has passed
            await bench.until(lambda n=number: len(bench.bundles) == n)
            if number == 2:
                bench.trigger(2, fell_ns)
                await bench.until(lambda: acquisition.counters.triggers_ignored == 1)
    names = ["00000001", "00000002-orphan", "00000003"]
    assert [name for kind, name in bench.told if kind == "trigger"] == names
    assert [bundle.name for bundle in bench.bundles] == names
    assert [len(bundle.frames) for bundle in bench.bundles] == [3, 3, 3]
    assert {bundle.trigger.kind for bundle in bench.bundles} == {
        BundleKind.BALL if is_ball else BundleKind.PARTICLE
    }


async def test_what_held_a_rig_that_is_disarmed_holds_it_no_longer():
    bench = HandBench()
    async with armed(bench) as acquisition:
        for device in list(bench.cameras.values())[:2]:
            assert device.sink is not None
            device.sink.deliver(CameraLost(camera=device.id, received_ns=bench.now_ns, reason="gone"))
        await bench.until(lambda: acquisition.state is AcquisitionState.HELD)
        assert acquisition.trouble is not None
        acquisition.request(AcquisitionTarget.DISARMED)
        await bench.until(lambda: acquisition.state is AcquisitionState.DISARMED)
        assert acquisition.trouble is None


@pytest.mark.parametrize(("count", "n_bundles"), [(100, 100), (10_000_000, 1)])
async def test_what_only_the_counter_saw_is_recorded_at_once(count: int, n_bundles: int):
    bench = HandBench()
    async with armed(bench) as acquisition:
        assert bench.gate.sink is not None
        bench.gate.sink.deliver(TriggersLost(received_ns=bench.now_ns, count=count, reason="gap"))
        await bench.until(lambda: acquisition.counters.triggers_lost == count)
        bench.now_ns += 10 * DELAY_NS
        await bench.until(lambda: len(bench.bundles) == n_bundles)
    assert bench.n_records == 1
    assert len({name for kind, name in bench.told if kind == "trigger"}) == n_bundles
    assert sum(bundle.trigger.n_stones for bundle in bench.bundles) == count


async def test_the_gates_count_is_noted_when_everything_before_it_is_recorded():
    bench = HandBench()
    counts = [GateCount(gate="a,b,1", sequence=n, device_us=n) for n in (1, 5, 6)]
    async with armed(bench):
        sink = bench.gate.sink
        assert sink is not None

        def fall(count: GateCount) -> None:
            sink.deliver(
                Trigger(
                    sequence=count.sequence, received_ns=bench.now_ns, device_ns=0, utc=UTC, gate_count=count
                )
            )

        fall(counts[0])
        await bench.until(lambda: bench.n_records == 1)
        bench.now_ns += 10 * DELAY_NS
        sink.deliver(TriggersLost(received_ns=bench.now_ns, count=3, reason="gap"))
        fall(counts[1])
        await bench.until(lambda: bench.n_records == 2)
        bench.now_ns += 10 * DELAY_NS
        await bench.until(lambda: bench.n_records == 3)  # those of the gap
        fall(counts[2])
        await bench.until(lambda: bench.n_records == 4)
        bench.now_ns += 10 * DELAY_NS  # or the end would wait for the images of the last one
        assert bench.gate_counts == [counts[0], None, None, counts[2]]
    assert bench.gate_counts[4:] == [None]  # disarmed: nothing is missed


async def test_what_the_gate_tells_late_or_not_at_all_is_a_warning() -> None:
    bench = HandBench()
    async with armed(bench) as acquisition:

        def warning() -> str:
            return "; ".join(acquisition.status().gate_warnings)

        fell_ns = []
        for number in (1, 2, 3):
            fell_ns.append(bench.now_ns)
            bench.now_ns += DELAY_NS
            bench.expose(number)
            bench.now_ns += DELAY_NS
            await bench.until(lambda n=number: len(bench.bundles) == n)
        assert warning().startswith(
            "the cameras expose and the gate says nothing, 3 stones in a row: look at"
        )
        bench.trigger(3, fell_ns[2])
        await bench.until(lambda: acquisition.counters.triggers_ignored == 1)
        assert "2 stones within the last minute were not announced" in warning()
        assert "1 announcements within the last minute came too late for their frames: look at" in warning()
        assert bench.gate.sink is not None
        bench.gate.sink.deliver(TriggersLost(received_ns=bench.now_ns, count=3, reason="lines were damaged"))
        await bench.until(lambda: acquisition.counters.triggers_lost == 3)
        assert "its counter went on by 3 stones without their lines" in warning()
        assert "(lines were damaged): look at" in warning()
        bench.now_ns += 10 * DELAY_NS
        await bench.until(lambda: len(bench.bundles) == 4)  # two of the three were seen
        assert [bool(bundle.frames) for bundle in bench.bundles] == [True, True, True, False]
        assert len({bundle.name for bundle in bench.bundles}) == acquisition.counters.triggers == 4


async def fall(
    bench: HandBench, number: int, *, prompt: Collection[CameraId], late: Collection[CameraId]
) -> None:
    """One stone, of which some cameras show images in time, some too late, and the others none."""
    bench.trigger(number, bench.now_ns)
    await bench.until(lambda: ("trigger", f"{number:08d}") in bench.told)
    bench.now_ns += DELAY_NS
    exposed_ns = bench.now_ns
    bench.expose(number, prompt)
    bench.now_ns += 2 * DELAY_NS  # the deadline has passed
    await bench.until(lambda: len(bench.bundles) == number)
    n_frames = sum(camera.frames for camera in bench.acquisition.cameras.statuses())
    bench.expose(number, late, exposed_ns)
    await bench.until(
        lambda: sum(c.frames for c in bench.acquisition.cameras.statuses()) == n_frames + len(late)
    )


async def test_cameras_whose_images_come_too_late_are_not_opened_anew() -> None:
    """An overloaded machine would be busy with opening them for ever: 14 of 16 cameras were lost, the rig held."""
    bench = HandBench()
    async with armed(bench) as acquisition:
        await fall(bench, 1, prompt=CAMERAS, late=())
        for number in range(2, 4 * MAX_MISSES):
            await fall(bench, number, prompt=CAMERAS[:1], late=CAMERAS[1:])
        assert acquisition.state is AcquisitionState.ARMED
        assert {camera.recoveries for camera in acquisition.cameras.statuses()} == {0}
        assert ["could not be used" in str(c.warnings) for c in acquisition.cameras.statuses()] == [
            False,
            True,
            True,
        ]
        await fall(bench, 4 * MAX_MISSES, prompt=CAMERAS, late=())
        assert set(bench.bundles[-1].frames) == set(CAMERAS)


async def test_a_camera_that_loses_every_other_image_is_named() -> None:
    """A network that drops packets takes images of now this camera, now that one: hardly ever three in a row."""
    bench = HandBench()
    async with armed(bench) as acquisition:
        for number in range(1, 2 * MAX_RECENT_MISSES + 1):
            lossy = () if number % 2 else CAMERAS[1:2]
            assert not any(camera.warnings for camera in acquisition.cameras.statuses())
            await fall(bench, number, prompt=[c for c in CAMERAS if c not in lossy], late=())
        told = [camera.warnings for camera in acquisition.cameras.statuses()]
        assert [len(warnings) for warnings in told] == [0, 1, 0]
        assert told[1][0].startswith(f"{MAX_RECENT_MISSES} of its latest {2 * MAX_RECENT_MISSES} images")
        for number in range(2 * MAX_RECENT_MISSES + 1, 2 * MAX_RECENT_MISSES + RECENT_TRIGGERS):
            await fall(bench, number, prompt=CAMERAS, late=())
        assert not any(camera.warnings for camera in acquisition.cameras.statuses())


async def test_a_rig_that_was_held_as_no_images_came_gets_out_of_it_by_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Cameras are opened anew again and again, also one that sent a last image late; then all of them send."""
    monkeypatch.setattr(device_keeper, "BACK_OFF_S", (0.0,))
    bench = HandBench()
    async with armed(bench) as acquisition:
        await fall(bench, 1, prompt=CAMERAS, late=())
        await fall(bench, 2, prompt=CAMERAS[:1], late=CAMERAS[1:2])
        for number in range(3, 6 * MAX_MISSES):
            await fall(bench, number, prompt=CAMERAS[:1], late=())
            await bench.until(lambda: acquisition.cameras.armed == len(CAMERAS))
        assert all(camera.recoveries > 1 for camera in acquisition.cameras.statuses()[1:])
        assert AcquisitionState.HELD in [state for state, _ in bench.entered]
        for number in range(6 * MAX_MISSES, 6 * MAX_MISSES + 3):
            await fall(bench, number, prompt=CAMERAS, late=())
        assert acquisition.state is AcquisitionState.ARMED
        assert set(bench.bundles[-1].frames) == set(CAMERAS)
