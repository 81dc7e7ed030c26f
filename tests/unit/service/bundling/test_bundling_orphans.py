"""Frames without a trigger and triggers without frames: orphans, strays, gaps of the gate."""

import sys

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
    feed_all,
    frame,
    tags,
    trigger,
)

from drivers.interfaces import DeviceEvent, TriggersLost
from pipeline.frames import MissingReason
from service.bundling.assembler import DELIVERY_NS, LATE_NS, BundleAssembler
from service.bundling.missed_triggers import MAX_ORPHANS, MAX_SINGLE, CounterGap, MissedTriggers
from service.bundling.window import BundlingParameters


def test_frames_wait_for_a_late_trigger_and_are_strays_without_one() -> None:
    parameters = BundlingParameters(expected_delay_ms=0, window_ms=50, dead_time_ms=200)
    assembler = BundleAssembler(CAMERAS, parameters)
    events = [*(frame(camera, 0, 1000) for camera in CAMERAS), trigger(0, 30 * MS)]
    (bundle,) = feed_all(assembler, events)
    assert not bundle.missing
    feed_all(assembler, [frame(A, 1, 500 * MS)])
    assembler.advance(601 * MS)
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


def test_a_line_that_comes_after_its_frames_were_adopted_announces_no_second_stone() -> None:
    """The host was too busy to read it: the gate's clock says when its stone fell."""
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    period_ns = 250 * MS
    bundles = feed_all(assembler, [trigger(0, 0), *(frame(camera, 0, DELAY_NS) for camera in CAMERAS)])
    for number in (1, 2):
        late = [frame(camera, number, number * period_ns + DELAY_NS) for camera in CAMERAS]
        bundles += feed_all(assembler, late[number - 1 :])  # the second lacks one
    bundles += assembler.advance(3 * period_ns + DELAY_NS)
    bundles += feed_all(assembler, [trigger(1, period_ns), trigger(2, 2 * period_ns + 5 * MS)])
    bundles += feed_all(assembler, [trigger(5, 5 * period_ns)])
    bundles += feed_all(assembler, [TriggersLost(received_ns=5 * period_ns, count=2, reason="gap")])
    bundles += assembler.advance(20 * period_ns)
    assert [(bundle.trigger.sequence, len(bundle.frames)) for bundle in bundles] == [
        (0, 3),
        (1, 3),
        (2, 2),
        (5, 0),
        (6, 0),
        (6, 0),
    ]
    counters = assembler.counters
    assert (counters.triggers, counters.orphans, counters.unseen) == (6, 2, 2)
    assert counters.triggers_ignored == 2


def test_of_two_orphans_one_is_announced_late_and_the_other_explains_the_gap() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    period_ns = 250 * MS
    for number in (0, 1):
        feed_all(assembler, [frame(camera, number, number * period_ns + DELAY_NS) for camera in CAMERAS])
    assembler.advance(3 * period_ns)
    gap = TriggersLost(received_ns=3 * period_ns, count=1, reason="gap")
    feed_all(assembler, [trigger(1, 0), gap, trigger(3, 3 * period_ns)])
    assembler.advance(10 * period_ns)
    counters = assembler.counters
    assert (counters.triggers, counters.orphans, counters.unseen) == (3, 2, 0)


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


def test_what_fell_while_no_daemon_ran_says_so_unless_the_cameras_saw_it() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    feed_all(assembler, [frame(camera, 0, DELAY_NS) for camera in CAMERAS])  # armed before the gate
    gap = TriggersLost(received_ns=1000 * MS, count=3, reason="gap", while_down=True)
    feed_all(assembler, [gap])
    assert assembler.missed.has_gap
    bundles = assembler.advance(1000 * MS + DELAY_NS + WINDOW_NS + DELIVERY_NS)
    assert not assembler.missed.has_gap
    assert [set(bundle.missing.values()) for bundle in bundles] == [{"down"}, {"down"}]
    assert (assembler.counters.orphans, assembler.counters.unseen) == (1, 2)


def test_a_flood_of_late_frames_makes_no_stone_of_its_own() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    feed_all(assembler, [trigger(0, 0), *(frame(camera, 0, DELAY_NS, device_ns=1) for camera in CAMERAS)])
    feed_all(assembler, [trigger(1, 250 * MS)])
    assembler.advance(1000 * MS)
    late = [frame(camera, 1, 1500 * MS, device_ns=250 * MS) for camera in CAMERAS]
    assert feed_all(assembler, late) + assembler.advance(5000 * MS) == []
    assert [assembler.counters.cameras[camera].late for camera in CAMERAS] == [1, 1, 1]
    assert assembler.counters.orphans == 0


def test_a_long_gap_is_one_bundle_with_a_number_and_a_short_one_a_bundle_for_each_stone() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    for count, n_bundles in ((10_000_000, 1), (MAX_SINGLE, MAX_SINGLE), (MAX_SINGLE + 1, 1)):
        feed_all(assembler, [TriggersLost(received_ns=0, count=count, reason="gap", while_down=True)])
        bundles = assembler.advance(1000 * MS)
        assert len(bundles) == n_bundles
        assert sum(bundle.trigger.n_stones for bundle in bundles) == count
        assert {reason for bundle in bundles for reason in bundle.missing.values()} == {"down"}
    total = 10_000_000 + 2 * MAX_SINGLE + 1
    counters = assembler.counters
    assert (counters.triggers, counters.incomplete, counters.unseen) == (total, total, total)


def test_orphans_explain_some_stones_of_a_long_gap() -> None:
    assembler = BundleAssembler(CAMERAS, PARAMETERS)
    feed_all(assembler, [frame(camera, 0, DELAY_NS) for camera in CAMERAS])
    (orphan,) = assembler.advance(1000 * MS)
    feed_all(assembler, [TriggersLost(received_ns=1000 * MS, count=1001, reason="gap")])
    (rest,) = assembler.advance(2000 * MS)
    assert (orphan.trigger.n_stones, rest.trigger.n_stones) == (1, 1000)


def test_orphans_without_number_are_a_number_and_explain_what_the_gate_tells_late() -> None:
    """A gate that is silent for a day keeps a thousand times in memory, and its count still adds up."""
    missed = MissedTriggers(tolerance_ns=10 * MS)
    n_orphans = 3 * MAX_ORPHANS
    for number in range(n_orphans):
        missed.note_orphan(number * 1000 * MS)
    assert sys.getsizeof(missed._orphans_ns) < 10 * MAX_ORPHANS
    late = trigger(2, (n_orphans - 1) * 1000 * MS)
    assert missed.has_orphan_of(late)
    missed.note_gap(CounterGap(0, n_orphans - 500, MissingReason.UNSEEN, due_ns=1))
    assert missed.take_unseen(1) == []
    missed.note_gap(CounterGap(0, 700, MissingReason.UNSEEN, due_ns=1))
    assert [each.n_triggers for each in missed.take_unseen(1)] == [700 - 500]
    missed.note_orphan(0)
    missed.note_announced(trigger(1, 1000 * MS))
    missed.note_gap(CounterGap(0, 1, MissingReason.UNSEEN, due_ns=1))
    assert len(missed.take_unseen(1)) == 1  # the gate missed nothing before the one that it announced


@pytest.mark.parametrize("late_ms", [0, 30, 90])
def test_a_stone_that_was_not_announced_between_two_in_the_air_is_an_orphan(late_ms: int) -> None:
    """However late this machine takes all frames, by their clocks they are neither the one's nor the other's."""
    assembler = BundleAssembler(CAMERAS, QUICK)
    bundles = []
    events: list[tuple[int, DeviceEvent]] = []
    for number, at_ms in enumerate((0, 1000, 1040, 1100)):
        at_ns = at_ms * MS
        if number != 2:
            events.append((at_ns, trigger(number, at_ns)))
        arrival_ns = at_ns + QUICK_DELAY_NS + (late_ms * MS if number else 0)
        events += [(arrival_ns, frame(camera, number, arrival_ns, device_ns=7 + at_ns)) for camera in CAMERAS]
    for now_ns, event in sorted(events, key=lambda event: event[0]):
        bundles += assembler.advance(now_ns) + assembler.feed(event)
    bundles += assembler.advance(2000 * MS)
    assert sorted((bundle.trigger.sequence, tags(bundle)) for bundle in bundles) == [
        (n, {n}) for n in range(4)
    ]
    (orphan,) = (bundle for bundle in bundles if not bundle.trigger.is_announced)
    assert orphan.trigger.received_ns == 1040 * MS
    feed_all(assembler, [trigger(2, 1040 * MS)])  # its line was late
    assert (assembler.counters.orphans, assembler.counters.triggers) == (1, 4)


def test_the_frames_of_the_next_stone_wait_for_their_own_line() -> None:
    """Two lines are late, and the first is taken for an orphan just before they come."""
    assembler = BundleAssembler(CAMERAS, QUICK)
    times_ns = [0, 26 * MS, 52 * MS]
    bundles = feed_all(assembler, [trigger(0, 0)])
    for number, at_ns in enumerate(times_ns):
        arrival_ns = at_ns + QUICK_DELAY_NS
        bundles += feed_all(assembler, [frame(c, number, arrival_ns, device_ns=7 + at_ns) for c in CAMERAS])
    bundles += assembler.advance(times_ns[1] + QUICK_DELAY_NS + LATE_NS + 1)
    bundles += feed_all(assembler, [trigger(1, times_ns[1]), trigger(2, times_ns[2])])
    bundles += assembler.advance(1000 * MS)
    assert [(tags(bundle), bundle.trigger.is_announced) for bundle in bundles] == [
        ({0}, True),
        ({1}, False),
        ({2}, True),
    ]
    assert not any(bundle.missing for bundle in bundles)
