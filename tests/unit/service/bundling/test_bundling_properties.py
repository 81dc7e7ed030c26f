"""Each trigger gets one bundle of its own frames, whatever the cameras and the network do.

On a rig whose cameras wait while a stone falls, and on one with up to nine stones in the air.
"""

from dataclasses import dataclass, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.bundling import CAMERAS, MS, PARAMETERS, QUICK, accounted, frame, tags, trigger
from support.extents import examples

from drivers.interfaces import DeviceEvent, FrameLost
from pipeline.frames import CameraId, Frame, FrameBundle
from service.bundling.assembler import BundleAssembler
from service.bundling.window import BundlingParameters


@dataclass(frozen=True)
class Fate:
    """What happens to the exposure of one camera for one trigger."""

    jitter_ns: int = 0
    is_lost: bool = False
    is_told: bool = False  # of a lost one
    n_copies: int = 1
    late_ns: int = 0
    lag_ns: int = 0  # from arrival to delivery


@dataclass(frozen=True)
class Rig:
    """How a rig bundles, and how stones fall through it."""

    parameters: BundlingParameters
    gaps_ms: tuple[int, ...]

    @property
    def delay_ns(self) -> int:
        return round(self.parameters.expected_delay_ms * MS)

    @property
    def jitters_ns(self) -> st.SearchStrategy[int]:
        most_ns = round(0.9 * self.parameters.window_ms) * MS
        return st.integers(-most_ns, most_ns)

    @property
    def on_time(self) -> st.SearchStrategy[Fate]:
        copies = st.sampled_from([1, 1, 1, 2, 3])
        return st.builds(Fate, jitter_ns=self.jitters_ns, lag_ns=lags_ns, n_copies=copies)

    @property
    def lost(self) -> st.SearchStrategy[Fate]:
        return st.builds(Fate, is_lost=st.just(True), is_told=st.booleans(), jitter_ns=self.jitters_ns)

    @property
    def late(self) -> st.SearchStrategy[Fate]:
        late_ns = st.sampled_from([gap_ms * MS for gap_ms in (*self.gaps_ms[:3], 500)]) | st.integers(
            0, 2_000 * MS
        )
        copies = st.sampled_from([1, 1, 2])
        return st.builds(Fate, jitter_ns=self.jitters_ns, late_ns=late_ns, n_copies=copies)

    @property
    def times_ns(self) -> st.SearchStrategy[list[int]]:
        gaps = st.lists(st.sampled_from(self.gaps_ms), min_size=2, max_size=12)
        return gaps.map(lambda gaps_ms: [10**12 + sum(gaps_ms[:i]) * MS for i in range(len(gaps_ms))])


lags_ns = st.integers(0, 40 * MS)
RIGS = {
    "cameras wait": Rig(PARAMETERS, (225, 250, 400, 250, 250, 1500, 60_000)),
    "stones in the air": Rig(QUICK, (26, 50, 100, 31, 100, 100, 137, 400, 1500, 60_000)),
}
every_rig = pytest.mark.parametrize("rig", RIGS.values(), ids=RIGS)


@st.composite
def cameras(draw: st.DrawFn, *, has_clock: bool) -> tuple[int, bool, int, float]:
    first_id = draw(st.sampled_from([1, 65_401, 65_533, 2**64 - 4, 10**9]))
    epoch_ns = draw(st.integers(1, 10**18)) if has_clock else 0
    return first_id, first_id <= 0xFFFF, epoch_ns, draw(st.floats(-50e-6, 50e-6))


def exposures(
    rig: Rig, camera: CameraId, times_ns: list[int], fates: list[Fate], device: tuple[int, bool, int, float]
) -> list[tuple[int, DeviceEvent]]:
    """What the camera delivers, with the times of delivery."""
    first_id, is_16_bit, epoch_ns, drift = device
    delivered: list[tuple[int, DeviceEvent]] = []
    for number, (trigger_ns, fate) in enumerate(zip(times_ns, fates, strict=True)):
        frame_id = (first_id - 1 + number) % (0xFFFF if is_16_bit else 2**64 - 1) + 1
        arrival_ns = trigger_ns + rig.delay_ns + fate.jitter_ns + fate.late_ns
        if fate.is_lost:
            if fate.is_told:
                event = FrameLost(camera=camera, received_ns=arrival_ns, reason="incomplete")
                delivered.append((arrival_ns, event))
            continue
        device_ns = epoch_ns + round((trigger_ns - times_ns[0]) * (1 + drift)) if epoch_ns else 0
        shot = frame(camera, number, arrival_ns, frame_id, device_ns)
        delivered += [(arrival_ns + fate.lag_ns + copy, shot) for copy in range(fate.n_copies)]
    return delivered


def run(
    rig: Rig, times_ns: list[int], deliveries: list[tuple[int, DeviceEvent]]
) -> tuple[list[FrameBundle], BundleAssembler]:
    assembler = BundleAssembler(CAMERAS, rig.parameters)
    triggers = [(at_ns, trigger(number, at_ns)) for number, at_ns in enumerate(times_ns)]
    bundles = []
    for now_ns, event in sorted([*triggers, *deliveries], key=lambda delivery: delivery[0]):
        bundles += assembler.advance(now_ns)
        bundles += assembler.feed(event)
    return bundles + assembler.flush(), assembler


def check_each_trigger_once(
    bundles: list[FrameBundle],
    assembler: BundleAssembler,
    times_ns: list[int],
    deliveries: list[tuple[int, DeviceEvent]],
) -> None:
    assert [bundle.trigger.received_ns for bundle in bundles] == times_ns
    for number, bundle in enumerate(bundles):
        assert tags(bundle) <= {number}, "a frame exposed for another trigger"
        assert set(bundle.frames) | set(bundle.missing) == set(CAMERAS)
        assert not set(bundle.frames) & set(bundle.missing)
    counters = assembler.counters
    assert counters.triggers == len(times_ns) == counters.complete + counters.incomplete
    for camera in CAMERAS:
        n_frames = sum(isinstance(event, Frame) and event.camera == camera for _, event in deliveries)
        assert accounted(counters.cameras[camera]) == n_frames


@every_rig
@examples(1.2)
@given(data=st.data(), has_clock=st.booleans())
def test_each_trigger_gets_one_bundle_with_the_right_missing_set(
    rig: Rig, data: st.DataObject, has_clock: bool
) -> None:
    """Under loss, jitter, duplication, reordering and wrapping ids."""
    times_ns = data.draw(rig.times_ns)
    fates = {
        # the very first exposure is what a camera's clock is compared with
        camera: [data.draw(rig.on_time), *(data.draw(rig.on_time | rig.lost) for _ in times_ns[1:])]
        for camera in CAMERAS
    }
    deliveries = [
        delivery
        for camera in CAMERAS
        for delivery in exposures(
            rig, camera, times_ns, fates[camera], data.draw(cameras(has_clock=has_clock))
        )
    ]
    bundles, assembler = run(rig, times_ns, deliveries)
    check_each_trigger_once(bundles, assembler, times_ns, deliveries)
    for number, bundle in enumerate(bundles):
        expected = {
            camera: "incomplete" if fates[camera][number].is_told else "no_frame"
            for camera in CAMERAS
            if fates[camera][number].is_lost
        }
        assert dict(bundle.missing) == expected
    for counters in assembler.counters.cameras.values():
        assert (counters.not_exposed, counters.unannounced, counters.id_restarts) == (0, 0, 0)


@every_rig
@examples(1.5)
@given(data=st.data())
def test_no_bundle_ever_holds_a_frame_of_another_trigger(rig: Rig, data: st.DataObject) -> None:
    """Not even when frames arrive whole periods late, exactly when the next one is due."""
    times_ns = data.draw(rig.times_ns)
    deliveries = [
        delivery
        for camera in CAMERAS
        for delivery in exposures(
            rig,
            camera,
            times_ns,
            [data.draw(rig.on_time), *(data.draw(rig.on_time | rig.lost | rig.late) for _ in times_ns[1:])],
            data.draw(cameras(has_clock=True)),
        )
    ]
    bundles, assembler = run(rig, times_ns, deliveries)
    check_each_trigger_once(bundles, assembler, times_ns, deliveries)


@every_rig
@examples(0.5)
@given(data=st.data())
def test_no_frame_that_comes_before_the_deadline_is_wasted(rig: Rig, data: st.DataObject) -> None:
    """However late each comes and in whatever order: the camera's clock knows its trigger."""
    times_ns = data.draw(rig.times_ns)
    in_time_ns = round(rig.parameters.window_ms + 250) * MS
    overdue = st.builds(Fate, jitter_ns=st.just(0), late_ns=st.integers(0, in_time_ns), lag_ns=lags_ns)
    deliveries = [
        delivery
        for camera in CAMERAS
        for delivery in exposures(
            rig,
            camera,
            times_ns,
            [data.draw(rig.on_time), *(data.draw(overdue) for _ in times_ns[1:])],
            data.draw(cameras(has_clock=True)),
        )
    ]
    bundles, assembler = run(rig, times_ns, deliveries)
    check_each_trigger_once(bundles, assembler, times_ns, deliveries)
    assert not any(bundle.missing for bundle in bundles)


@every_rig
@examples(0.6)
@given(data=st.data())
def test_a_clock_that_is_set_while_stones_fall_moves_no_frame(rig: Rig, data: st.DataObject) -> None:
    """By a master that comes and goes, be it by whole periods: the camera's counter still knows better."""
    times_ns = data.draw(rig.times_ns)
    deliveries = []
    for camera in CAMERAS:
        fates = [data.draw(rig.on_time), *(data.draw(rig.on_time | rig.lost) for _ in times_ns[1:])]
        at_ns = data.draw(st.sampled_from(times_ns))
        step_ns = (
            data.draw(
                st.sampled_from([-500, -250, *(-gap_ms for gap_ms in rig.gaps_ms[:3]), *rig.gaps_ms[:3]])
                | st.integers(-600, 600)
            )
            * MS
        )
        for delivered_ns, event in exposures(
            rig, camera, times_ns, fates, data.draw(cameras(has_clock=True))
        ):
            if isinstance(event, Frame) and times_ns[int(event.image[0, 0])] >= at_ns:
                event = replace(event, device_ns=event.device_ns + 10**9 + step_ns)
            elif isinstance(event, Frame):
                event = replace(event, device_ns=event.device_ns + 10**9)
            deliveries.append((delivered_ns, event))
    bundles, assembler = run(rig, times_ns, deliveries)
    check_each_trigger_once(bundles, assembler, times_ns, deliveries)


@every_rig
@examples(0.6)
@given(data=st.data())
def test_a_stone_whose_line_is_late_is_one_stone(rig: Rig, data: st.DataObject) -> None:
    """However late the lines are read, in their order: either they get the frames, or the frames came without."""
    times_ns = data.draw(rig.times_ns)
    fates = [Fate() for _ in times_ns]
    deliveries = []
    for camera in CAMERAS:
        deliveries += exposures(rig, camera, times_ns, fates, data.draw(cameras(has_clock=True)))
    late_ns = st.sampled_from([0, 0, 0, 300 * MS]) | st.integers(0, 3_000 * MS)
    read_ns = [times_ns[0], *(at_ns + data.draw(late_ns) for at_ns in times_ns[1:])]
    for number, at_ns in enumerate(times_ns):
        deliveries.append((max(read_ns[: number + 1]), trigger(number, at_ns)))
    bundles, assembler = run(rig, [], deliveries)
    assert sorted(tag for bundle in bundles for tag in tags(bundle)) == list(range(len(times_ns)))
    assert not any(bundle.missing for bundle in bundles)
    assert assembler.counters.triggers == len(times_ns) == assembler.counters.complete
