"""Which trigger a frame belongs to, when it comes late or its camera is set anew: clocks and counters."""

import pytest
from support.bundling import (
    CAMERAS,
    DELAY_NS,
    MS,
    PARAMETERS,
    QUICK,
    QUICK_DELAY_NS,
    WINDOW_NS,
    A,
    B,
    C,
    accounted,
    feed_all,
    frame,
    tags,
    trigger,
)

from drivers.errors import LossCause
from drivers.interfaces import CameraBack, CameraLost, DeviceEvent
from pipeline.frames import CameraId, Frame
from service.bundling.assembler import BundleAssembler


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


@pytest.mark.parametrize(("stalled_ms", "is_measured"), [(0, False), (1000, True)])
def test_no_deadline_runs_while_the_host_stands_still(stalled_ms: int, is_measured: bool) -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    feed_all(assembler, [trigger(0, 0), *(frame(camera, 0, DELAY_NS, device_ns=7) for camera in CAMERAS)])
    assembler.feed(trigger(1, 500 * MS))
    assembler.extend_deadlines(stalled_ms * MS)
    woken_ns = 500 * MS + DELAY_NS + 900 * MS
    bundles = assembler.advance(woken_ns)
    bundles += feed_all(assembler, [frame(camera, 1, woken_ns, device_ns=7 + 500 * MS) for camera in CAMERAS])
    (bundle,) = bundles
    assert tags(bundle) == ({1} if is_measured else set())


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
    """A trigger that waits for a frame does not get the next one's: the camera's counter knows better, and vouches."""
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
    assert assembler.counters.cameras[A].other_exposure == 1


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


@pytest.mark.parametrize(
    ("cause", "is_measured"), [(LossCause.PROCESS_ENDED, True), (LossCause.SILENT, False)]
)
def test_a_camera_that_kept_its_power_kept_its_clock(cause: LossCause, is_measured: bool) -> None:
    """Its first image after another loss proves nothing; the process of the cameras dies without their clocks."""
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    feed_all(assembler, [trigger(0, 0), *(frame(camera, 0, DELAY_NS, device_ns=7) for camera in CAMERAS)])
    for camera in CAMERAS:
        assembler.feed(CameraLost(camera=camera, received_ns=300 * MS, reason="gone", cause=cause))
        assembler.feed(CameraBack(camera=camera, received_ns=900 * MS))
    at_ns = 1000 * MS
    events = [frame(camera, 1, at_ns + DELAY_NS, frame_id=1, device_ns=7 + at_ns) for camera in CAMERAS]
    bundles = feed_all(assembler, [trigger(1, at_ns), *events]) + assembler.flush()
    assert [tags(bundle) for bundle in bundles] == [{1} if is_measured else set()]


@pytest.mark.parametrize("late_ms", [0, 15, 60])
def test_a_camera_that_missed_an_exposure_is_believed_again_however_late_its_frames_are(late_ms: int) -> None:
    """Its counter is behind by one from then on, and no frame comes within the short window."""
    assembler, period_ns, bundles = BundleAssembler(CAMERAS, QUICK), 100 * MS, []
    events: list[tuple[int, DeviceEvent]] = []
    for number in range(8):
        at_ns = number * period_ns
        events.append((at_ns, trigger(number, at_ns)))
        for camera in CAMERAS:
            arrival_ns = at_ns + QUICK_DELAY_NS + (late_ms * MS if camera == A else 0)
            has_missed = camera == A and number > 3
            shot = frame(camera, number, arrival_ns, number + 1 - has_missed, device_ns=7 + at_ns)
            if (camera, number) != (A, 3):
                events.append((arrival_ns, shot))
    for now_ns, event in sorted(events, key=lambda event: event[0]):
        bundles += assembler.advance(now_ns) + assembler.feed(event)
    bundles += assembler.flush()
    assert [tags(bundle) for bundle in bundles] == [{number} for number in range(8)]
    first_after = {4} if late_ms > QUICK.window_ms else set()  # the counter is behind
    assert {n for n, bundle in enumerate(bundles) if A in bundle.missing} == {3} | first_after


@pytest.mark.parametrize(("late_ms", "n_refused"), [(0, 1), (15, 7)])
def test_a_camera_that_comes_back_among_stones_in_the_air_gives_them_no_frame_of_another(
    late_ms: int, n_refused: int
) -> None:
    assembler, bundles = BundleAssembler(CAMERAS, QUICK), []
    times_ns = [at_ms * MS for at_ms in (0, 100, 230, 330, 480, 580, 660, 800, 950, 1050, 1150, 1300)]
    events: list[tuple[int, DeviceEvent]] = [
        (-2, CameraLost(camera=A, received_ns=-2, reason="gone", cause=LossCause.SILENT)),
        (90 * MS, CameraBack(camera=A, received_ns=90 * MS)),
    ]
    for number, at_ns in enumerate(times_ns):
        events.append((at_ns, trigger(number, at_ns)))
        for camera in CAMERAS:
            arrival_ns = at_ns + QUICK_DELAY_NS + (late_ms * MS if camera == A else 0)
            if camera != A or number:
                events.append((arrival_ns, frame(camera, number, arrival_ns, device_ns=7 + at_ns)))
    for now_ns, event in sorted(events, key=lambda event: event[0]):
        bundles += assembler.advance(now_ns) + assembler.feed(event)
    bundles += assembler.flush()
    assert [tags(bundle) for bundle in bundles] == [{number} for number in range(len(times_ns))]
    assert sum(A in bundle.missing for bundle in bundles) == 1 + n_refused
