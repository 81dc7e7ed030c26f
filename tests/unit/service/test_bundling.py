from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.interfaces import (
    CameraBack,
    CameraLost,
    DeviceEvent,
    FrameLost,
    GateLost,
    PlaybackEnded,
    PulseEnded,
    TriggersIgnored,
    TriggersLost,
)
from pipeline.frames import BundleKind, CameraId, Frame, FrameBundle, Trigger
from service.bundle_counters import CameraCounters
from service.bundling import DELIVERY_NS, BundleAssembler
from service.bundling_parameters import BundlingParameters

CAMERAS = tuple(CameraId(f"c{i:02d}") for i in range(1, 4))
A, B, C = CAMERAS
MS = 1_000_000
DELAY_NS = round(259.4 * MS)
WINDOW_NS = 100 * MS
PARAMETERS = BundlingParameters()


def trigger(sequence: int, at_ns: int, kind: BundleKind = BundleKind.PARTICLE) -> Trigger:
    return Trigger(
        sequence=sequence, received_ns=at_ns, device_ns=at_ns, utc="2026-01-01T00:00:00Z", kind=kind
    )


def frame(camera: CameraId, tag: int, at_ns: int, frame_id: int | None = None, device_ns: int = 0) -> Frame:
    """A frame whose only pixel says for which trigger it was exposed."""
    return Frame(
        camera=camera,
        image=np.full((1, 1), tag, np.uint8),
        frame_id=tag + 1 if frame_id is None else frame_id,
        device_ns=device_ns,
        received_ns=at_ns,
    )


def tags(bundle: FrameBundle) -> set[int]:
    return {int(shown.image[0, 0]) for shown in bundle.frames.values()}


def feed_all(assembler: BundleAssembler, events: Iterable[DeviceEvent]) -> list[FrameBundle]:
    return [bundle for event in events for bundle in assembler.feed(event)]


def accounted(counters: CameraCounters) -> int:
    """Frames of which the counters say what became of them."""
    c = counters
    return c.used + c.late + c.duplicates + c.extra + c.other_exposure + c.strays


# --- examples ---


def test_a_bundle_leaves_as_soon_as_it_is_complete() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    assert assembler.next_deadline_ns is None
    assert feed_all(assembler, [trigger(0, 0), frame(B, 0, DELAY_NS), frame(A, 0, DELAY_NS)]) == []
    assert assembler.next_deadline_ns == DELAY_NS + WINDOW_NS + DELIVERY_NS
    (bundle,) = assembler.feed(frame(C, 0, DELAY_NS))
    assert list(bundle.frames) == list(CAMERAS)
    assert not bundle.missing
    assert (assembler.counters.complete, assembler.counters.incomplete) == (1, 0)
    assert assembler.flush() == []


def test_the_deadline_names_what_is_missing() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    lost = FrameLost(camera=B, received_ns=DELAY_NS, reason="incomplete")
    assert feed_all(assembler, [trigger(0, 0), frame(A, 0, DELAY_NS), lost]) == []
    deadline_ns = assembler.next_deadline_ns
    assert deadline_ns is not None
    assert assembler.advance(deadline_ns - 1) == []
    (bundle,) = assembler.advance(deadline_ns)
    assert dict(bundle.missing) == {B: "incomplete", C: "no_frame"}
    assert assembler.counters.cameras[B].lost == 1
    assert assembler.feed(frame(C, 0, deadline_ns + 1)) == []
    assembler.flush()
    assert assembler.counters.cameras[C].late == 1


def test_a_lost_camera_is_not_waited_for_until_it_sends_again() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    period_ns = 250 * MS
    assembler.feed(trigger(0, 0))
    assembler.feed(CameraLost(camera=C, received_ns=10, reason="unplugged"))
    (first,) = feed_all(assembler, [frame(A, 0, DELAY_NS), frame(B, 0, DELAY_NS)])
    assert dict(first.missing) == {C: "camera_lost"}
    second = [trigger(1, period_ns), *(frame(camera, 1, period_ns + DELAY_NS) for camera in (C, A, B))]
    (bundle,) = feed_all(assembler, second)
    assert not bundle.missing


def test_a_camera_that_is_back_is_waited_for_again() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    assembler.feed(CameraLost(camera=C, received_ns=0, reason="unplugged"))
    assembler.feed(CameraBack(camera=C, received_ns=5))
    events = [trigger(0, 10), frame(A, 0, DELAY_NS), frame(B, 0, DELAY_NS)]
    assert feed_all(assembler, events) == []
    (bundle,) = assembler.feed(frame(C, 0, DELAY_NS + MS))
    assert not bundle.missing


def test_a_trigger_within_the_dead_time_gets_an_empty_bundle() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    events = [trigger(0, 0), trigger(1, 3 * MS), *(frame(camera, 0, DELAY_NS) for camera in CAMERAS)]
    first, second = feed_all(assembler, events)
    assert (first.trigger.sequence, set(first.frames)) == (0, set(CAMERAS))
    assert (second.trigger.sequence, dict(second.missing)) == (1, dict.fromkeys(CAMERAS, "dead_time"))
    assert assembler.counters.in_dead_time == 1


def test_the_clock_of_the_gate_decides_whether_a_trigger_was_too_soon() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    late = replace(trigger(0, 40 * MS), device_ns=1)  # heard 40 ms late
    assembler.feed(late)
    assembler.feed(replace(trigger(1, 250 * MS), device_ns=1 + 250 * MS))
    assert assembler.counters.in_dead_time == 0
    assembler.feed(replace(trigger(2, 400 * MS), device_ns=1))  # the gate's clock began anew
    assert assembler.counters.in_dead_time == 1


def test_frames_wait_for_a_late_trigger_and_are_strays_without_one() -> None:
    parameters = BundlingParameters(expected_delay_ms=0, window_ms=50, dead_time_ms=200)
    assembler = BundleAssembler(CAMERAS, parameters)
    events = [*(frame(camera, 0, 1000) for camera in CAMERAS), trigger(0, 30 * MS)]
    (bundle,) = feed_all(assembler, events)
    assert not bundle.missing
    feed_all(assembler, [frame(A, 1, 500 * MS)])
    assembler.advance(600 * MS)
    assert assembler.counters.cameras[A].strays == 1


def test_a_stone_that_the_gate_did_not_announce_is_an_orphan_with_a_bundle_of_its_own() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    period_ns = 250 * MS
    bundles = feed_all(
        assembler,
        [
            trigger(7, 0),
            *(frame(camera, 0, DELAY_NS) for camera in CAMERAS),
            *(frame(camera, 1, period_ns + DELAY_NS) for camera in (A, B)),  # 8 was garbled
            trigger(9, 2 * period_ns),
            TriggersLost(received_ns=2 * period_ns, count=1, reason="gap"),
            *(frame(camera, 2, 2 * period_ns + DELAY_NS) for camera in CAMERAS),
        ],
    )
    bundles += assembler.advance(10 * period_ns)
    assert [(bundle.trigger.sequence, bundle.trigger.is_announced) for bundle in bundles] == [
        (7, True),
        (8, False),
        (9, True),
    ]
    orphan = bundles[1]
    assert orphan.trigger.received_ns == period_ns
    assert (tags(orphan), dict(orphan.missing)) == ({1}, {C: "no_frame"})
    counters = assembler.counters
    assert (counters.triggers, counters.orphans, counters.unseen, counters.triggers_lost) == (3, 1, 0, 1)
    assert all(each.not_exposed == each.unannounced == 0 for each in counters.cameras.values())


def test_an_orphan_explains_one_gap_and_a_spurious_one_none() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    period_ns, bundles = 250 * MS, []
    feed_all(assembler, [frame(camera, 9, DELAY_NS) for camera in CAMERAS])  # a pulse from nowhere
    for number in range(1, 5):
        at_ns = (number + 3) * period_ns
        bundles += feed_all(
            assembler, [trigger(number, at_ns), *(frame(c, number, at_ns + DELAY_NS) for c in CAMERAS)]
        )
    assert assembler.counters.orphans == 1
    at_ns = 10 * period_ns
    feed_all(assembler, [trigger(6, at_ns), TriggersLost(received_ns=at_ns, count=1, reason="gap")])
    assembler.advance(20 * period_ns)
    assert assembler.counters.unseen == 1


def test_three_orphans_explain_gaps_that_are_told_one_by_one() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    period_ns = 250 * MS
    feed_all(assembler, [trigger(1, 0), *(frame(camera, 0, DELAY_NS) for camera in CAMERAS)])
    for number in range(1, 4):
        feed_all(assembler, [frame(camera, number, number * period_ns + DELAY_NS) for camera in CAMERAS])
    assembler.advance(8 * period_ns)
    assert assembler.counters.orphans == 3
    for count, at_ns in ((1, 8 * period_ns), (2, 13 * period_ns)):
        assembler.feed(TriggersLost(received_ns=at_ns, count=count, reason="gap"))
        assembler.advance(at_ns + 4 * period_ns)
    assert assembler.counters.unseen == 0


def test_what_only_the_counter_of_the_gate_knows_is_a_bundle_without_frames() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    feed_all(assembler, [trigger(0, 0), *(frame(camera, 0, DELAY_NS) for camera in CAMERAS)])
    gap = TriggersLost(received_ns=1000 * MS, count=2, reason="gap")
    assert feed_all(assembler, [trigger(3, 1000 * MS), gap]) == []
    bundles = feed_all(assembler, [frame(camera, 3, 1000 * MS + DELAY_NS) for camera in CAMERAS])
    bundles += assembler.advance(1000 * MS + DELAY_NS + WINDOW_NS + DELIVERY_NS)
    assert [len(bundle.frames) for bundle in bundles] == [3, 0, 0]
    assert set(bundles[1].missing.values()) == {"unseen"}
    assert assembler.counters.triggers == 4 == assembler.counters.complete + assembler.counters.incomplete


def test_a_flood_of_late_frames_makes_no_stone_of_its_own() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    feed_all(assembler, [trigger(0, 0), *(frame(camera, 0, DELAY_NS, device_ns=1) for camera in CAMERAS)])
    feed_all(assembler, [trigger(1, 250 * MS)])
    assembler.advance(1000 * MS)
    late = [frame(camera, 1, 1500 * MS, device_ns=250 * MS) for camera in CAMERAS]
    assert feed_all(assembler, late) + assembler.advance(5000 * MS) == []
    assert [assembler.counters.cameras[camera].late for camera in CAMERAS] == [1, 1, 1]
    assert assembler.counters.orphans == 0


@pytest.mark.parametrize(("after_ms", "is_in_view"), [(30, True), (100, False)])
def test_a_background_with_a_stone_in_it_shows_nothing(after_ms: int, is_in_view: bool) -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    empty = trigger(0, 0, BundleKind.BACKGROUND)
    background, stone = feed_all(
        assembler, [empty, trigger(1, after_ms * MS), *(frame(camera, 0, DELAY_NS) for camera in CAMERAS)]
    )
    assert background.kind is BundleKind.BACKGROUND
    assert set(background.missing.values()) == ({"stone_passed"} if is_in_view else set())
    assert len(background.frames) == (0 if is_in_view else 3)
    assert set(stone.missing.values()) == {"dead_time"}


def test_the_width_of_the_pulse_is_known_before_the_bundle_is() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    pulse = PulseEnded(sequence=0, received_ns=70 * MS, width_ns=70 * MS)
    (bundle,) = feed_all(assembler, [trigger(0, 0), pulse, *(frame(c, 0, DELAY_NS) for c in CAMERAS)])
    assert bundle.trigger.pulse_width_ns == 70 * MS


def test_two_different_frames_for_one_trigger_are_both_refused() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    events = [
        trigger(0, 0),
        frame(A, 0, DELAY_NS),
        frame(A, 9, DELAY_NS + MS),
        frame(A, 9, DELAY_NS + 2 * MS),
    ]
    feed_all(assembler, events)
    (bundle,) = feed_all(assembler, [frame(B, 0, DELAY_NS), frame(C, 0, DELAY_NS)])
    assert dict(bundle.missing) == {A: "ambiguous"}
    assert assembler.counters.cameras[A].extra == 3


@pytest.mark.parametrize(
    ("n_periods", "missing"),
    [
        (1, [{}, {}, {A: "no_frame"}, {}, {}]),
        (2, [{}, {A: "no_frame"}, {}, {A: "other_exposure"}, {}]),  # its own trigger waits no longer
    ],
)
def test_a_frame_late_by_whole_periods_never_stands_in_for_another(
    n_periods: int, missing: list[dict[CameraId, str]]
) -> None:
    """The fault that matching by arrival cannot see: the camera's own clock does."""
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    period_ns = 250 * MS

    def shot(camera: CameraId, tag: int, arrives_with: int) -> Frame:
        device_ns = 5_000 * MS + tag * period_ns
        return frame(camera, tag, arrives_with * period_ns + DELAY_NS, device_ns=device_ns)

    bundles = []
    for number in range(5):
        bundles += assembler.feed(trigger(number, number * period_ns))
        bundles += assembler.advance(number * period_ns + DELAY_NS)
        for camera in CAMERAS:
            if camera == A and number == 1 + n_periods:
                bundles += assembler.feed(shot(A, 1, arrives_with=number))  # and its own is lost
            elif (camera, number) != (A, 1):
                bundles += assembler.feed(shot(camera, number, arrives_with=number))
    bundles += assembler.flush()
    assert [dict(bundle.missing) for bundle in bundles] == missing
    assert [tags(bundle) for bundle in bundles] == [{number} for number in range(5)]


@pytest.mark.parametrize("late_ms", [101, 149, 151, 399])
@pytest.mark.parametrize("is_next_due", [True, False])
def test_a_frame_that_comes_after_its_window_is_used_while_its_trigger_waits(
    late_ms: int, is_next_due: bool
) -> None:
    """A busy machine takes frames late from the network: between two windows, or in the next one's."""
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    times_ns = [0, 250 * MS, 500 * MS] if is_next_due else [0, 250 * MS]
    arrivals = [
        (at_ns + DELAY_NS + (late_ms * MS if (camera, number) == (A, 1) else 0), camera, number)
        for number, at_ns in enumerate(times_ns)
        for camera in CAMERAS
    ]
    events: list[tuple[int, DeviceEvent]] = [
        *((at_ns, trigger(number, at_ns)) for number, at_ns in enumerate(times_ns)),
        *(
            (at_ns, frame(camera, number, at_ns, device_ns=7 + times_ns[number]))
            for at_ns, camera, number in arrivals
        ),
    ]
    bundles = feed_all(assembler, [event for _, event in sorted(events, key=lambda event: event[0])])
    assert [dict(bundle.missing) for bundle in bundles] == [{}] * len(times_ns)
    assert [tags(bundle) for bundle in bundles] == [{number} for number in range(len(times_ns))]
    assert accounted(assembler.counters.cameras[A]) == len(times_ns)


def test_the_first_frame_of_a_camera_may_come_until_the_next_window_opens() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    period_ns, bundles = 220 * MS, []
    for number in range(3):
        at_ns = number * period_ns
        bundles += assembler.feed(trigger(number, at_ns))
        for camera in CAMERAS:
            late_ns = 119 * MS if (camera, number) == (C, 0) else 0
            shot = frame(camera, number, at_ns + DELAY_NS + late_ns, device_ns=7 + at_ns)
            bundles += assembler.feed(shot)
    assert [dict(bundle.missing) for bundle in bundles] == [{}, {}, {}]
    assert [tags(bundle) for bundle in bundles] == [{0}, {1}, {2}]


def test_without_a_clock_a_frame_after_its_window_is_late() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    feed_all(assembler, [trigger(0, 0), *(frame(camera, 0, DELAY_NS) for camera in CAMERAS)])
    feed_all(assembler, [trigger(1, 250 * MS), *(frame(c, 1, 250 * MS + DELAY_NS) for c in (B, C))])
    feed_all(assembler, [frame(A, 1, 251 * MS + DELAY_NS + WINDOW_NS)])
    (bundle,) = assembler.flush()
    assert dict(bundle.missing) == {A: "no_frame"}
    assert assembler.counters.cameras[A].late == 1


def test_a_camera_whose_clock_was_set_anew_loses_one_frame() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    period_ns = 250 * MS
    bundles = []
    for number in range(5):
        device_ns = number * period_ns + (9 * 10**15 if number < 2 else 77)
        bundles += assembler.feed(trigger(number, number * period_ns))
        for camera in CAMERAS:
            bundles += assembler.feed(
                frame(
                    camera, number, number * period_ns + DELAY_NS, device_ns=device_ns if camera == A else 0
                )
            )
    bundles += assembler.flush()
    assert [set(bundle.missing) for bundle in bundles] == [set(), set(), {A}, set(), set()]


@pytest.mark.parametrize("step_ms", [-250, 250, -500])
def test_a_clock_that_is_set_by_whole_periods_moves_no_frame(step_ms: int) -> None:
    """A trigger that waits for a frame does not get the next one's: the camera's counter knows better."""
    assembler, period_ns, bundles = BundleAssembler(CAMERAS, PARAMETERS), 250 * MS, []
    for number in range(6):
        at_ns = number * period_ns
        bundles += assembler.feed(trigger(number, at_ns))
        device_ns = 10**9 + at_ns + (step_ms * MS if number >= 2 else 0)
        for camera in CAMERAS:
            shot = frame(camera, number, at_ns + DELAY_NS, device_ns=device_ns if camera == A else 0)
            bundles += assembler.feed(shot)
    bundles += assembler.flush()
    assert [tags(bundle) for bundle in bundles] == [{number} for number in range(6)]
    assert assembler.counters.cameras[A].other_exposure == 4


def test_ids_tell_losses_from_missed_exposures() -> None:
    assembler = BundleAssembler([A, B, C], PARAMETERS)
    ids = {A: [65534, 1, None, 3, 1], B: [7, 8, None, 9, 10], C: [5, 6, 8, 9, 10]}
    for number in range(5):
        at_ns = number * 300 * MS
        feed_all(assembler, [trigger(number, at_ns)])
        for camera in CAMERAS:
            if (frame_id := ids[camera][number]) is not None:
                feed_all(assembler, [frame(camera, number, at_ns + DELAY_NS, frame_id)])
    assembler.flush()
    checks = {
        camera: (counters.not_exposed, counters.unannounced, counters.id_restarts, counters.missing)
        for camera, counters in assembler.counters.cameras.items()
    }
    # A: wraps, loses one in transit, restarts; B: did not see a trigger; C: exposed once too often
    assert checks == {A: (0, 1, 1, 1), B: (1, 0, 0, 1), C: (0, 1, 0, 0)}


def test_other_events_only_count_or_flush() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    assembler.feed(trigger(0, 0, BundleKind.BACKGROUND))
    assert assembler.feed(TriggersIgnored(received_ns=1, count=2, reason="bounce")) == []
    assert assembler.feed(GateLost(received_ns=2, reason="unplugged")) == []
    (bundle,) = assembler.feed(PlaybackEnded(received_ns=3))
    assert bundle.kind is BundleKind.BACKGROUND
    assert assembler.counters.triggers_ignored == 2
    assembler.feed(trigger(1, 10**9))
    (bundle,) = assembler.flush("shutdown")
    assert dict(bundle.missing) == dict.fromkeys(CAMERAS, "shutdown")


@pytest.mark.parametrize(
    "wrong",
    [
        {"expected_delay_ms": -1},
        {"window_ms": 0},
        {"window_ms": 110},
        {"dead_time_ms": 200},
        {"window_ms": float("nan")},
    ],
)
def test_parameters_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"must (be in|exceed)"):
        replace(PARAMETERS, **wrong)


# --- properties ---


@dataclass(frozen=True)
class Fate:
    """What happens to the exposure of one camera for one trigger."""

    jitter_ns: int = 0
    is_lost: bool = False
    is_told: bool = False  # of a lost one
    n_copies: int = 1
    late_ns: int = 0
    lag_ns: int = 0  # from arrival to delivery


jitters_ns = st.integers(-90 * MS, 90 * MS)
lags_ns = st.integers(0, 40 * MS)
on_time = st.builds(Fate, jitter_ns=jitters_ns, lag_ns=lags_ns, n_copies=st.sampled_from([1, 1, 1, 2, 3]))
lost = st.builds(Fate, is_lost=st.just(True), is_told=st.booleans(), jitter_ns=jitters_ns)


@st.composite
def trigger_times_ns(draw: st.DrawFn) -> list[int]:
    gaps_ms = draw(
        st.lists(st.sampled_from([225, 250, 250, 250, 400, 1500, 60_000]), min_size=2, max_size=10)
    )
    return [10**12 + round(sum(gaps_ms[:i])) * MS for i in range(len(gaps_ms))]


@st.composite
def cameras(draw: st.DrawFn, *, has_clock: bool) -> tuple[int, bool, int, float]:
    first_id = draw(st.sampled_from([1, 65_401, 65_533, 2**64 - 4, 10**9]))
    epoch_ns = draw(st.integers(1, 10**18)) if has_clock else 0
    return first_id, first_id <= 0xFFFF, epoch_ns, draw(st.floats(-50e-6, 50e-6))


def exposures(
    camera: CameraId, times_ns: list[int], fates: list[Fate], device: tuple[int, bool, int, float]
) -> list[tuple[int, DeviceEvent]]:
    """What the camera delivers, with the times of delivery."""
    first_id, is_16_bit, epoch_ns, drift = device
    delivered: list[tuple[int, DeviceEvent]] = []
    for number, (trigger_ns, fate) in enumerate(zip(times_ns, fates, strict=True)):
        frame_id = (first_id - 1 + number) % (0xFFFF if is_16_bit else 2**64 - 1) + 1
        arrival_ns = trigger_ns + DELAY_NS + fate.jitter_ns + fate.late_ns
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
    times_ns: list[int], deliveries: list[tuple[int, DeviceEvent]]
) -> tuple[list[FrameBundle], BundleAssembler]:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
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


@settings(max_examples=120)
@given(data=st.data(), times_ns=trigger_times_ns(), has_clock=st.booleans())
def test_each_trigger_gets_one_bundle_with_the_right_missing_set(
    data: st.DataObject, times_ns: list[int], has_clock: bool
) -> None:
    """Under loss, jitter, duplication, reordering and wrapping ids."""
    fates = {
        # the very first exposure is what a camera's clock is compared with
        camera: [data.draw(on_time), *(data.draw(on_time | lost) for _ in times_ns[1:])]
        for camera in CAMERAS
    }
    deliveries = [
        delivery
        for camera in CAMERAS
        for delivery in exposures(camera, times_ns, fates[camera], data.draw(cameras(has_clock=has_clock)))
    ]
    bundles, assembler = run(times_ns, deliveries)
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


late = st.builds(
    Fate,
    jitter_ns=jitters_ns,
    late_ns=st.sampled_from([225 * MS, 250 * MS, 500 * MS]) | st.integers(0, 2_000 * MS),
    n_copies=st.sampled_from([1, 1, 2]),
)


@settings(max_examples=150)
@given(data=st.data(), times_ns=trigger_times_ns())
def test_no_bundle_ever_holds_a_frame_of_another_trigger(data: st.DataObject, times_ns: list[int]) -> None:
    """Not even when frames arrive whole periods late, exactly when the next one is due."""
    deliveries = [
        delivery
        for camera in CAMERAS
        for delivery in exposures(
            camera,
            times_ns,
            [data.draw(on_time), *(data.draw(on_time | lost | late) for _ in times_ns[1:])],
            data.draw(cameras(has_clock=True)),
        )
    ]
    bundles, assembler = run(times_ns, deliveries)
    check_each_trigger_once(bundles, assembler, times_ns, deliveries)


@settings(max_examples=50)
@given(data=st.data(), times_ns=trigger_times_ns())
def test_no_frame_that_comes_before_the_deadline_is_wasted(data: st.DataObject, times_ns: list[int]) -> None:
    """However late each comes and in whatever order: the camera's clock knows its trigger."""
    overdue = st.builds(Fate, jitter_ns=st.just(0), late_ns=st.integers(0, 350 * MS), lag_ns=lags_ns)
    deliveries = [
        delivery
        for camera in CAMERAS
        for delivery in exposures(
            camera,
            times_ns,
            [data.draw(on_time), *(data.draw(overdue) for _ in times_ns[1:])],
            data.draw(cameras(has_clock=True)),
        )
    ]
    bundles, assembler = run(times_ns, deliveries)
    check_each_trigger_once(bundles, assembler, times_ns, deliveries)
    assert not any(bundle.missing for bundle in bundles)


@settings(max_examples=60)
@given(data=st.data(), times_ns=trigger_times_ns())
def test_a_clock_that_is_set_while_stones_fall_moves_no_frame(
    data: st.DataObject, times_ns: list[int]
) -> None:
    """By a master that comes and goes, be it by whole periods: the camera's counter still knows better."""
    deliveries = []
    for camera in CAMERAS:
        fates = [data.draw(on_time), *(data.draw(on_time | lost) for _ in times_ns[1:])]
        at_ns = data.draw(st.sampled_from(times_ns))
        step_ns = data.draw(st.sampled_from([-500, -250, -225, 225, 250]) | st.integers(-600, 600)) * MS
        for delivered_ns, event in exposures(camera, times_ns, fates, data.draw(cameras(has_clock=True))):
            if isinstance(event, Frame) and times_ns[int(event.image[0, 0])] >= at_ns:
                event = replace(event, device_ns=event.device_ns + 10**9 + step_ns)
            elif isinstance(event, Frame):
                event = replace(event, device_ns=event.device_ns + 10**9)
            deliveries.append((delivered_ns, event))
    bundles, assembler = run(times_ns, deliveries)
    check_each_trigger_once(bundles, assembler, times_ns, deliveries)


def test_every_counter_is_covered_by_the_account() -> None:
    """A new counter of frames must enter `accounted`, or be one of those that count something else."""
    others = {"missing", "lost", "not_exposed", "unannounced", "id_restarts"}
    one_each = CameraCounters(**{each.name: 1 for each in fields(CameraCounters)})
    assert accounted(one_each) == len(fields(CameraCounters)) - len(others)
