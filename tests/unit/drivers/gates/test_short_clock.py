"""A gate whose clock has 32 bits: wraps are counted on, restarts told, neither taken for the other."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from drivers.gates.edge_counter import MAX_BURST, OUT_OF_ORDER_US, SHORT_CLOCK_US, UNREAD_US, EdgeCounter
from drivers.gates.gate_listener import GateListener
from drivers.gates.gate_protocol import STONEFALL, encode
from drivers.gates.gate_records import SEQUENCES, Edge, Identity, Record, Status
from drivers.interfaces import DeviceEvent, TriggersLost
from pipeline.frames import GateCount, Trigger

SECOND_US = 1_000_000
HOUR_US = 3600 * SECOND_US
GAPS_US = st.one_of(st.integers(1000, 2 * SECOND_US), st.integers(SECOND_US, 20 * HOUR_US))
ME = Identity(name="a", serial="b", version="c")


@dataclass
class Board:
    """A gate, its host and the counter under test, at one time; the board's crystal is off by `drift_ppm`."""

    bits: int
    drift_ppm: int
    host_us: int = 5 * HOUR_US
    on_us: int = 0  # since it was switched on, by its own clock
    count: int = 0
    counter: EdgeCounter = field(default_factory=EdgeCounter)

    def wait(self, gap_us: int) -> None:
        self.host_us += gap_us
        self.on_us += gap_us + gap_us * self.drift_ppm // 1_000_000

    def restart(self) -> None:
        self.on_us = self.count = 0

    @property
    def sent_us(self) -> int:
        return self.on_us % (1 << self.bits)

    @property
    def sent_count(self) -> int:
        return self.count % SEQUENCES


@pytest.mark.parametrize("bits", [32, 64])
@given(
    drift_ppm=st.integers(-200, 200),
    on_us=st.integers(0, 3 * SHORT_CLOCK_US),
    first=st.integers(0, SEQUENCES),
    steps=st.lists(st.tuples(GAPS_US, st.integers(0, MAX_BURST), st.booleans()), min_size=1, max_size=12),
)
def test_no_wrap_is_a_restart_however_long_the_host_heard_nothing(
    bits: int, drift_ppm: int, on_us: int, first: int, steps: list[tuple[int, int, bool]]
) -> None:
    board = Board(bits, drift_ppm, on_us=on_us, count=first)
    began = board.counter.status(board.sent_count, board.sent_us, board.host_us * 1000)
    began_us = board.on_us
    for gap_us, n_unheard, is_edge in steps:
        board.wait(gap_us)
        board.count += n_unheard + is_edge
        take = board.counter.edge if is_edge else board.counter.status
        step = take(board.sent_count, board.sent_us, board.host_us * 1000)
        assert not step.has_restarted
        assert step.missed == n_unheard
        assert step.sequence - began.sequence == board.count - first
        assert step.device_us - began.device_us == board.on_us - began_us
        assert board.counter.sent_us(step.device_us) == board.sent_us
        assert step.has_wrapped <= (bits == 32)


@pytest.mark.parametrize("bits", [32, 64])
@given(
    on_us=st.integers(0, 2 * SHORT_CLOCK_US),
    first=st.integers(1, 1_000_000),
    heard_us=GAPS_US,
    off_us=st.integers(0, 20 * HOUR_US),
    since_us=GAPS_US,
    data=st.data(),
)
def test_a_count_that_goes_back_is_a_restart_whatever_the_clock_says(
    bits: int, on_us: int, first: int, heard_us: int, off_us: int, since_us: int, data: st.DataObject
) -> None:
    board = Board(bits, 0, on_us=on_us, count=first)
    board.counter.status(board.sent_count, board.sent_us, board.host_us * 1000)
    board.wait(heard_us + off_us)
    board.restart()
    board.wait(since_us)
    board.count = data.draw(st.integers(0, min(first - 1, MAX_BURST)))
    step = board.counter.status(board.sent_count, board.sent_us, board.host_us * 1000)
    assert (step.has_restarted, step.has_wrapped) == (True, False)
    assert step.missed == board.count
    assert step.device_us == board.sent_us


@given(
    on_us=st.integers(10 * SECOND_US, SHORT_CLOCK_US - 1),
    first=st.integers(0, MAX_BURST),
    off_us=st.integers(0, 20 * HOUR_US),
    since_us=st.integers(0, 5 * SECOND_US),
    n_more=st.integers(0, MAX_BURST),
)
def test_a_count_that_goes_on_is_a_restart_if_the_clock_does_not_fit(
    on_us: int, first: int, off_us: int, since_us: int, n_more: int
) -> None:
    """The host's clock tells it from a wrap, unless it took just as long as the gate's clock had until its wrap."""
    board = Board(32, 0, on_us=on_us, count=first)
    board.counter.status(board.sent_count, board.sent_us, board.host_us * 1000)
    board.wait(off_us)
    board.restart()
    board.wait(since_us)
    board.count = min(first + n_more, MAX_BURST)
    until_wrap_us = (off_us + on_us) % SHORT_CLOCK_US
    drift_us = OUT_OF_ORDER_US + (off_us + since_us) // 1000
    assume(drift_us + UNREAD_US < until_wrap_us < SHORT_CLOCK_US - drift_us)
    step = board.counter.status(board.sent_count, board.sent_us, board.host_us * 1000)
    assert (step.has_restarted, step.missed) == (True, board.count)


@pytest.mark.parametrize("bits", [32, 64])
@given(
    on_us=st.integers(UNREAD_US + 120 * SECOND_US, SHORT_CLOCK_US - HOUR_US),
    first=st.integers(0, 1_000_000),
    waited_us=st.integers(0, 10 * SECOND_US),
    back_us=st.integers(12 * SECOND_US, 60 * SECOND_US),
    n_more=st.integers(0, MAX_BURST),
)
def test_a_clock_that_goes_back_a_little_is_no_restart(
    bits: int, on_us: int, first: int, waited_us: int, back_us: int, n_more: int
) -> None:
    """A restart after the latest line would show a time since it: all stones since power-on were told as missed."""
    board = Board(bits, 0, on_us=on_us, count=first)
    board.counter.status(board.sent_count, board.sent_us, board.host_us * 1000)
    board.wait(waited_us)
    board.on_us -= back_us
    board.count += n_more
    step = board.counter.status(board.sent_count, board.sent_us, board.host_us * 1000)
    assert (step.has_restarted, step.missed, step.has_stepped_back) == (False, n_more, True)


def test_stones_after_a_clock_that_went_back_are_dated_by_its_new_time() -> None:
    listener = GateListener(STONEFALL, baud=4_000_000, debounce_ns=1000)
    on_us = 2 * HOUR_US
    assert not [*heard(listener, 0, ME, status(on_us, 22))]
    assert not [*heard(listener, 1_000_000, status(on_us - 4_000_000, 22))]
    (trigger,) = heard(listener, 1_500_000, Edge(23, on_us - 3_500_000))
    assert isinstance(trigger, Trigger)
    assert trigger.received_ns == pytest.approx(1_500_000_000, abs=1_000_000)
    assert (listener.counters.missed, listener.counters.restarts) == (0, 0)


@given(st.integers(0, SHORT_CLOCK_US), st.integers(0, UNREAD_US))
def test_lines_that_a_busy_host_reads_late_are_no_restart(before_us: int, late_us: int) -> None:
    board = Board(32, 0, on_us=SHORT_CLOCK_US - min(before_us, SECOND_US), count=22)
    board.counter.status(board.sent_count, board.sent_us, board.host_us * 1000)
    board.wait(2 * SECOND_US)
    board.host_us += late_us
    for _ in range(3):  # all of them at once
        step = board.counter.status(board.sent_count, board.sent_us, board.host_us * 1000)
        assert (step.has_restarted, step.missed) == (False, 0)
        board.on_us += SECOND_US


def test_an_edge_of_before_the_wrap_may_come_after_a_status_of_after_it() -> None:
    counter = EdgeCounter()
    counter.status(7, SHORT_CLOCK_US - 900_000, 0)
    status = counter.status(7, 100_000, 1_000_000_000)
    edge = counter.edge(8, SHORT_CLOCK_US - 20, 1_000_100_000)
    after = counter.status(8, 1_100_000, 2_000_000_000)
    assert [step.has_restarted for step in (status, edge, after)] == [False] * 3
    assert [step.device_us - SHORT_CLOCK_US for step in (status, edge, after)] == [100_000, -20, 1_100_000]
    assert [step.missed for step in (status, edge, after)] == [0, 0, 0]


def heard(listener: GateListener, host_us: int, *records: Record) -> Iterator[DeviceEvent]:
    yield from listener.hear(b"".join(map(encode, records)), host_us * 1000)


def status(device_us: int, last: int) -> Status:
    return Status(device_us=device_us % SHORT_CLOCK_US, last_sequence=last, ignored=0, is_blocked=False)


def test_a_wrap_costs_no_stone_and_is_said_as_long_as_it_is_the_same_gate() -> None:
    listener = GateListener(STONEFALL, baud=4_000_000, debounce_ns=1000)
    ends_us = SHORT_CLOCK_US - 500_000
    events = [*heard(listener, 0, ME, status(ends_us, 22))]
    events += heard(listener, 1_000_000, status(ends_us + 1_000_000, 22))
    assert events == []  # the field's case: 22 stones since power-on, of which none was lost
    (trigger,) = heard(listener, 1_500_000, Edge(23, (ends_us + 1_500_000) % SHORT_CLOCK_US))
    assert isinstance(trigger, Trigger)
    assert trigger.device_ns == (ends_us + 1_500_000) * 1000  # goes on
    assert trigger.gate_count == GateCount(gate="a,b,c", sequence=23, device_us=1_000_000)  # as it was sent
    assert (listener.counters.wraps, listener.counters.restarts) == (1, 0)
    (warning,) = listener.troubles(10**15)
    assert "its clock has 32 bits" in warning
    listener.hear(encode(Identity(name="a", serial="other", version="c")), 2_000_000_000)
    assert listener.troubles(10**15) == []


@pytest.mark.parametrize(("is_dated", "n_missed"), [(True, 3), (False, 25)])
def test_the_next_process_tells_a_wrap_if_it_knows_when_the_count_was_noted(
    is_dated: bool, n_missed: int
) -> None:
    """Without the time the count alone decides, as for a gate that lost its power."""
    listener = GateListener(STONEFALL, baud=4_000_000, debounce_ns=1000)
    noted_us = SHORT_CLOCK_US - 1_500_000
    listener.resume(GateCount(gate="a,b,c", sequence=22, device_us=noted_us), host_ns=0 if is_dated else None)
    hour_us = HOUR_US
    (lost,) = heard(listener, hour_us, ME, status(noted_us + hour_us, 25))
    assert isinstance(lost, TriggersLost)
    assert lost.count == n_missed
    assert listener.counters.restarts == (not is_dated)
