"""When a bundle leaves, and what it says is missing."""

from dataclasses import fields, replace

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
    trigger,
)

from drivers.interfaces import (
    CameraBack,
    CameraLost,
    FrameLost,
    GateLost,
    PlaybackEnded,
    PulseEnded,
    TriggersIgnored,
)
from pipeline.frames import BundleKind
from service.bundling.assembler import DELIVERY_NS, BundleAssembler
from service.bundling.frame_account import CameraCounters


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


@pytest.mark.parametrize("is_stone_first", [True, False])
@pytest.mark.parametrize(("apart_ms", "is_in_view"), [(30, True), (60, False)])
def test_a_stone_beside_a_test_pulse_is_measured_and_spoils_only_the_background(
    apart_ms: int, is_in_view: bool, is_stone_first: bool
) -> None:
    assembler = BundleAssembler(CAMERAS, QUICK)
    kinds = [BundleKind.BACKGROUND, BundleKind.PARTICLE]
    if is_stone_first:
        kinds.reverse()
    times_ns = [0, apart_ms * MS]
    events = [
        trigger(number, at_ns, kind) for number, (at_ns, kind) in enumerate(zip(times_ns, kinds, strict=True))
    ]
    bundles = feed_all(assembler, events)
    for number, at_ns in enumerate(times_ns):
        bundles += feed_all(assembler, [frame(camera, number, at_ns + QUICK_DELAY_NS) for camera in CAMERAS])
    by_kind = {bundle.kind: bundle for bundle in bundles}
    assert not by_kind[BundleKind.PARTICLE].missing
    missing = set(by_kind[BundleKind.BACKGROUND].missing.values())
    assert missing == ({"stone_passed"} if is_in_view else set())


def test_the_width_of_the_pulse_is_known_before_the_bundle_is() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    pulse = PulseEnded(sequence=0, received_ns=70 * MS, width_ns=70 * MS)
    (bundle,) = feed_all(assembler, [trigger(0, 0), pulse, *(frame(c, 0, DELAY_NS) for c in CAMERAS)])
    assert bundle.trigger.pulse_width_ns == 70 * MS


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


def test_every_counter_is_covered_by_the_account() -> None:
    """A new counter of frames must enter `accounted`, or be one of those that count something else."""
    others = {"missing", "lost", "not_exposed", "unannounced", "id_restarts"}
    one_each = CameraCounters(**{each.name: 1 for each in fields(CameraCounters)})
    assert accounted(one_each) == len(fields(CameraCounters)) - len(others)
