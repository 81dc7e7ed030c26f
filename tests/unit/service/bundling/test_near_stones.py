"""A bundle knows the stones that passed the gate so near in time that they may be in its pictures."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st
from support.bundling import CAMERAS, DELAY_NS, MS, PARAMETERS, feed_all, frame, trigger

from drivers.interfaces import DeviceEvent, PulseEnded
from pipeline.frames import BundleKind, FrameBundle, NearStone, Trigger
from service.bundling.assembler import BundleAssembler
from service.bundling.window import IN_VIEW_NS


def bundles_of(*triggers: Trigger, events: tuple[DeviceEvent, ...] = ()) -> dict[int, FrameBundle]:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    announced: list[DeviceEvent] = [*triggers, *events]
    bundles = feed_all(assembler, sorted(announced, key=lambda event: event.received_ns)) + assembler.flush()
    return {bundle.trigger.sequence: bundle for bundle in bundles}


def test_a_stone_in_the_dead_time_is_near_and_has_a_bundle_of_its_own() -> None:
    ended = PulseEnded(sequence=2, received_ns=30 * MS, width_ns=9 * MS)
    bundles = bundles_of(trigger(1, 0), trigger(2, 20 * MS), trigger(3, 400 * MS), events=(ended,))
    assert bundles[1].trigger.near_stones == (NearStone(20 * MS, 9 * MS),)
    assert bundles[2].trigger.near_stones == (NearStone(-20 * MS),)
    assert bundles[3].trigger.near_stones == ()


def test_an_earlier_stone_is_near_although_its_bundle_is_complete() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    shown = [frame(camera, 1, DELAY_NS) for camera in CAMERAS]
    (first, second) = feed_all(assembler, [trigger(1, 0), trigger(2, 49 * MS), *shown])
    assert (first.trigger.sequence, second.trigger.sequence) == (1, 2)
    assert second.trigger.near_stones == (NearStone(-49 * MS),)


def test_the_gates_own_clock_says_how_near() -> None:
    late_line = replace(trigger(2, 31 * MS), device_ns=20 * MS)
    assert bundles_of(replace(trigger(1, 0), device_ns=1), late_line)[1].trigger.near_stones == (
        NearStone(20 * MS - 1),
    )


def test_an_exposure_of_the_empty_rig_is_no_stone_and_has_none_near() -> None:
    bundles = bundles_of(trigger(1, 0), trigger(2, 20 * MS, BundleKind.BACKGROUND))
    assert [bundle.trigger.near_stones for bundle in bundles.values()] == [(), ()]


def test_a_replayed_stone_keeps_those_it_was_recorded_with() -> None:
    recorded = replace(trigger(1, 0), name="000001", near_stones=(NearStone(12 * MS, 5 * MS),))
    other = replace(trigger(2, 20 * MS), name="000002")
    assert [bundle.trigger for bundle in bundles_of(recorded, other).values()] == [recorded, other]


@given(st.lists(st.integers(1, 80), min_size=1, max_size=30))
def test_nearness_is_mutual_and_complete(spacings_ms: list[int]) -> None:
    times_ns = [MS * sum(spacings_ms[: n + 1]) for n in range(len(spacings_ms))]
    bundles = bundles_of(*(trigger(n, at_ns) for n, at_ns in enumerate(times_ns, start=1)))
    for n, at_ns in enumerate(times_ns, start=1):
        expected = [
            other - at_ns for other in times_ns if other != at_ns and abs(other - at_ns) <= IN_VIEW_NS
        ]
        assert [stone.later_ns for stone in bundles[n].trigger.near_stones] == expected
