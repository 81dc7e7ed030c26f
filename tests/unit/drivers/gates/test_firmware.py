"""The gate's firmware, its very binary on an emulated board: drivers/gates/firmware/gate.c."""

import random
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.emulated_board import HZ, MS, US, Board, BoardOnPort, Build, running
from support.eventually import PATIENCE_S, eventually
from support.extents import examples
from support.sinks import Collector

from drivers.gates import serial_gate
from drivers.gates.gate_protocol import FIRMWARE_NAME, FIRMWARE_VERSION, checksum, set_pulses
from drivers.gates.gate_records import CameraPulses, Edge, Identity, Record, Status, TestPulse, Width
from drivers.gates.serial_gate import SerialGate, SerialGateSettings
from drivers.interfaces import PulseEnded, TriggersIgnored
from pipeline.frames import BundleKind, Trigger

R = TypeVar("R", bound=Record)
START = 20 * MS
"""The board has started."""
FALL_US = 247_000
LEAST_US = 60
"""From an edge to its pulse without a delay."""


@pytest.fixture(scope="session")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    return Build.make(tmp_path_factory.mktemp("firmware"))


@pytest.fixture
def board(build: Build) -> Iterator[Board]:
    with running(build) as board:
        yield board


def delayed(board: Board, delay_us: int = FALL_US, pulse_us: int = 100) -> None:
    """Let the host set the delay, and the board write it down."""
    board.hear(set_pulses(delay_us, pulse_us), START)
    board.run(START + 60 * MS)
    board.received.clear()


def of(kind: type[R], board: Board) -> list[R]:
    return [record for record in board.records() if isinstance(record, kind)]


def delays(board: Board) -> list[int]:
    """Return cycles from each closing of the beam to the pulse of the same place in order."""
    return [rise - close for close, rise in zip(board.rises("beam"), board.rises("trigger"), strict=True)]


def assert_exact(cycles: list[int], delay_us: int) -> None:
    """Within an instruction of the emulator, which sees pins between two only; the microsecond is 16 cycles."""
    assert [each for each in cycles if abs(each - delay_us * US) > 6] == []


def test_it_says_who_it_is_and_what_it_does(board: Board) -> None:
    board.hear(b"?\n", START)
    board.run(START + 20 * MS)
    identity, pulses, status = board.records()
    assert isinstance(identity, Identity)
    assert (identity.name, identity.version) == (FIRMWARE_NAME, FIRMWARE_VERSION)
    assert len(identity.serial) == 20
    assert pulses == CameraPulses(delay_us=0, pulse_us=100, places=16, unmade=0)
    assert isinstance(status, Status)
    assert (status.last_sequence, status.ignored, status.is_blocked) == (0, 0, False)


def test_a_stone_is_told_at_once_and_its_width_when_the_beam_stays_open(board: Board) -> None:
    board.stone(at=100 * MS, width=3 * MS)
    board.run(2 * HZ + 100 * MS)
    edge, width, *statuses = board.records()
    assert isinstance(edge, Edge)
    assert edge.sequence == 1
    assert width == Width(1, 3000)
    assert board.received[0][0] - board.rises("beam")[0] < MS // 2
    assert [type(each) for each in statuses] == [Status, Status]
    first, second = of(Status, board)
    assert abs(second.device_us - first.device_us - 1_000_000) < 5000  # it sleeps for 4 ms at most
    assert first.last_sequence == second.last_sequence == 1


def test_times_are_those_of_the_edges_by_its_own_clock(board: Board) -> None:
    at = [100 * MS + n * 77_777 for n in range(20)]
    for cycle in at:
        board.stone(cycle, width=MS)
    board.run(400 * MS)
    edges = of(Edge, board)
    closings = board.rises("beam")
    assert len(edges) == 20
    for edge, closing in zip(edges, closings, strict=True):
        passed_us = edge.device_us - edges[0].device_us
        assert abs(passed_us - (closing - closings[0]) / US) <= 1


@pytest.mark.parametrize("delay_us", [0, LEAST_US, 4_095, 4_096, 4_097, FALL_US, 2_000_000])
def test_a_pulse_comes_when_it_is_due_to_the_cycle(board: Board, delay_us: int) -> None:
    delayed(board, delay_us)
    dice = random.Random(delay_us)  # noqa: S311 - nothing secret
    at = START + 100 * MS
    for _ in range(12):
        board.stone(at, width=MS)
        at += dice.randrange(300_000, 5_000_000)
    board.run(at + delay_us * US + 10 * MS)
    assert_exact(delays(board), delay_us or LEAST_US)
    assert {abs(width - 100 * US) <= 6 for width in board.widths("trigger")} == {True}
    assert board.rises("strobe") == board.rises("trigger")
    assert board.widths("strobe") == board.widths("trigger")


def test_pulses_that_wait_keep_their_own_times(board: Board) -> None:
    """Two stones 5 ms apart, eight in the air, at irregular times."""
    delayed(board)
    at = START + 100 * MS
    for after_ms in [0, 5, 31, 2, 60, 9, 50, 43, 3, 200, 5]:
        at += after_ms * MS
        board.stone(at, width=MS // 2)
    board.run(at + 300 * MS)
    assert_exact(delays(board), FALL_US)
    assert len(board.rises("trigger")) == 11


def test_a_burst_of_twenty_has_twenty_lines_and_as_many_pulses_as_places(board: Board) -> None:
    delayed(board)
    for n in range(20):
        board.stone(START + 100 * MS + n * 5 * MS, width=MS)
    board.run(START + 1200 * MS)
    assert [edge.sequence for edge in of(Edge, board)] == list(range(1, 21))
    assert len(of(Width, board)) == 20
    assert_exact(
        [rise - close for close, rise in zip(board.rises("beam"), board.rises("trigger"), strict=False)],
        FALL_US,
    )
    assert len(board.rises("trigger")) == 16
    assert of(CameraPulses, board)[-1] == CameraPulses(delay_us=FALL_US, pulse_us=100, places=16, unmade=4)


@examples(0.3)
@given(
    gaps_us=st.lists(st.integers(1_100, 60_000), min_size=1, max_size=60),
    delay_us=st.sampled_from([0, LEAST_US, 5_000, FALL_US]),
    pulse_us=st.integers(LEAST_US, 900),
)
def test_every_stone_has_a_number_and_a_pulse_at_its_time_or_found_no_place(
    build: Build, gaps_us: list[int], delay_us: int, pulse_us: int
) -> None:
    with running(build) as board:
        delayed(board, delay_us, pulse_us)
        at = START + 100 * MS
        for gap_us in gaps_us:
            board.stone(at, width=50 * US)
            at += gap_us * US
        board.run(at + FALL_US * US + 1100 * MS)
        due: list[int] = []
        for closing in board.rises("beam"):
            assume(all(abs(each - closing) > LEAST_US * US for each in due))  # freed just now, or not yet
            if sum(each > closing for each in due) < 16:
                due.append(closing + (delay_us or LEAST_US) * US)
        assert_exact([rise - each for rise, each in zip(board.rises("trigger"), due, strict=True)], 0)
        assert {abs(width - pulse_us * US) <= 6 for width in board.widths("trigger")} == {True}
        told = [edge.sequence for edge in of(Edge, board)]
        assert told == sorted(set(told))
        assert of(Status, board)[-1].last_sequence == len(gaps_us)
        unmade = [each.unmade for each in of(CameraPulses, board)]
        assert unmade[-1:] == [len(gaps_us) - len(due)] or (unmade == [] and len(due) == len(gaps_us))


def test_waiting_pulses_keep_their_time_when_the_delay_changes(board: Board) -> None:
    delayed(board)
    at = START + 100 * MS
    board.stone(at)
    board.hear(set_pulses(1000, 200), at + 50 * MS)
    board.stone(at + 100 * MS)
    board.stone(at + 246 * MS + 50 * US, width=MS // 2)  # its pulse begins while the other is up
    board.run(at + 400 * MS)
    closings, rises = board.rises("beam"), board.rises("trigger")
    assert_exact([rises[0] - closings[1]], 1000)
    assert_exact([rises[1] - closings[0]], FALL_US)
    assert 0 < rises[2] - (closings[2] + 1000 * US) < 250 * US, "comes right after the other"
    assert {round(width / US) for width in board.widths("trigger")} == {200}


def test_a_pulse_that_is_due_first_comes_first_whenever_it_was_ordered(board: Board) -> None:
    """The delay is made short while a pulse is up and another waits."""
    delayed(board, FALL_US, 900)
    at = START + 100 * MS
    board.stone(at, width=MS)
    board.stone(at + 100 * MS, width=MS)
    board.hear(set_pulses(100, 900), at + 200 * MS)
    board.stone(at + FALL_US * US + 500 * US, width=MS)
    board.run(at + 400 * MS)
    closings, rises = board.rises("beam"), board.rises("trigger")
    assert_exact([rises[0] - closings[0]], FALL_US)
    assert 300 * US < rises[1] - closings[2] < 450 * US, "right after the one that was up"
    assert_exact([rises[2] - closings[1]], FALL_US)


def test_the_beam_that_closes_again_within_a_millisecond_is_the_same_stone(board: Board) -> None:
    at = 100 * MS
    for open_us in (100, 950, 900):
        board.stone(at, width=MS)
        at += MS + open_us * US
    board.stone(at, width=MS)
    board.stone(at + 2 * MS + MS // 10, width=MS)  # open for 1.1 ms: another stone
    board.run(1100 * MS)
    assert [edge.sequence for edge in of(Edge, board)] == [1, 2]
    assert len(board.rises("trigger")) == 2
    first, second = of(Width, board)
    assert abs(first.width_us - (at + MS - 100 * MS) / US) <= 1, "from the first closing to the last opening"
    assert second == Width(2, 1000)
    assert of(Status, board)[-1].ignored == 3


def test_spikes_are_no_stones_and_no_openings(board: Board) -> None:
    for n in range(200):
        board.stone(100 * MS + n * 2 * MS + n * 37, width=20)
    at = 600 * MS
    board.order("beam", at, 1)
    for n in range(1, 10):
        board.order("beam", at + n * MS, 0)
        board.order("beam", at + n * MS + 20, 1)
    board.order("beam", at + 10 * MS, 0)
    board.run(2100 * MS)
    assert [type(record) for record in board.records()] == [Edge, Width, Status, Status]
    assert of(Width, board) == [Width(1, 10_000)]
    assert len(board.rises("trigger")) == 1
    assert of(Status, board)[-1].ignored == 200


def test_noise_on_the_beam_never_leaves_it_in_the_wrong_state(board: Board) -> None:
    delayed(board, 5000)
    dice = random.Random(7)  # noqa: S311 - nothing secret
    at = START + 100 * MS
    for _ in range(300):
        at += dice.choice([15, 40, 90, 200, 500, 3 * MS])
        board.order("beam", at, dice.randrange(2))
    board.order("beam", at + 10, 0)
    board.stone(at + 20 * MS, width=2 * MS)
    board.run(at + 1100 * MS)
    edges, widths = of(Edge, board), of(Width, board)
    assert [edge.sequence for edge in edges] == list(range(1, len(edges) + 1))
    assert [width.sequence for width in widths] == [edge.sequence for edge in edges]
    assert widths[-1] == Width(len(edges), 2000)
    assert len(board.rises("trigger")) == len(edges)
    status = of(Status, board)[-1]
    assert (status.last_sequence, status.is_blocked) == (len(edges), False)


def test_a_beam_that_is_closed_at_the_start_or_stays_closed_is_blocked_and_no_stone(board: Board) -> None:
    board.order("beam", 0, 1)
    board.order("beam", 1500 * MS, 0)
    board.order("beam", 2500 * MS, 1)
    board.run(4100 * MS)
    assert [status.is_blocked for status in of(Status, board)] == [True, False, True, True]
    assert [edge.sequence for edge in of(Edge, board)] == [1]
    assert of(Width, board) == []
    assert [level for _, name, level in board.levels if name == "lamp"] == [1, 0, 1]


def test_the_width_of_a_beam_that_was_closed_for_hours(board: Board) -> None:
    """Far longer than its count of cycles of 32 bits, 268 s; its clock is put forward meanwhile."""
    board.stone(100 * MS, width=200 * MS)
    board.run(200 * MS)
    skipped_turns, n_turns = 2_000_000, board.now // 65536
    board.order("memory", board.now, board.build.address("turns"), skipped_turns.to_bytes(4, "little").hex())
    board.run(400 * MS)
    (width,) = of(Width, board)
    skipped_us = (skipped_turns - n_turns) << 12
    assert abs(width.width_us - skipped_us - 200_000) <= 2 * 4096


def test_a_test_pulse_is_counted_told_and_delayed_like_an_edge(board: Board) -> None:
    delayed(board)
    at = START + 100 * MS
    board.stone(at, width=MS)
    board.hear(b"T\n", at + 20 * MS)
    board.run(at + 400 * MS)
    edge, width, pulse = board.records()
    assert isinstance(edge, Edge)
    assert isinstance(pulse, TestPulse)
    assert (edge.sequence, width, pulse.sequence) == (1, Width(1, 1000), 2)
    of_edge, of_pulse = board.rises("trigger")
    assert abs((of_pulse - of_edge) / US - (pulse.device_us - edge.device_us)) <= 1


def test_noise_on_the_line_costs_commands_and_nothing_else(board: Board) -> None:
    dice = random.Random(3)  # noqa: S311 - nothing secret
    noise = bytes(dice.choice([*range(10), *range(11, 84), *range(85, 256)]) for _ in range(400))
    board.hear(noise + b"\n" + set_pulses(77_000, 300)[:-5] + set_pulses(88_000, 400), START)
    board.hear(b"\n?\n", START + 900_000)
    board.stone(START + 200_000, width=2 * MS)
    board.run(START + 200 * MS)
    assert [edge.sequence for edge in of(Edge, board)] == [1]
    assert {(told.delay_us, told.pulse_us) for told in of(CameraPulses, board)} == {(88_000, 400)}
    assert len(of(Identity, board)) == 1
    assert of(TestPulse, board) == []


@pytest.mark.parametrize(
    "command",
    [
        set_pulses(1, 100),
        set_pulses(LEAST_US - 1, 100),
        set_pulses(2_000_001, 100),
        set_pulses(4_294_967_295, 100),
        set_pulses(1000, LEAST_US - 1),
        set_pulses(1000, 901),
        set_pulses(1000, 65_636),  # 100 in 16 bits
        set_pulses(1000, 100).replace(b"1000", b"1001"),
        b"$D,*%04X\n" % checksum(b"D,"),
        b"$D,1000*%04X\n" % checksum(b"D,1000"),
        b"$D,1000,100,5*%04X\n" % checksum(b"D,1000,100,5"),
        b"$D,-1000,100*%04X\n" % checksum(b"D,-1000,100"),
        set_pulses(1000, 100)[:-2] + b"\n",
        set_pulses(1000, 100)[:-1] + b"0\n",
    ],
)
def test_what_it_cannot_do_changes_nothing_and_is_answered(board: Board, command: bytes) -> None:
    delayed(board, 4321, 321)
    board.hear(command, START + 80 * MS)
    board.run(START + 200 * MS)
    assert board.records() == [CameraPulses(delay_us=4321, pulse_us=321, places=16, unmade=0)]


def test_the_delay_outlives_a_reset_and_a_damaged_one_is_none(board: Board) -> None:
    delayed(board, FALL_US, 250)
    board.order("reset", 200 * MS)
    board.hear(b"?\n", 300 * MS)
    board.run(400 * MS)
    assert of(CameraPulses, board) == [CameraPulses(delay_us=FALL_US, pulse_us=250, places=16, unmade=0)]
    kept = board.eeprom
    start = next(i for i, byte in enumerate(kept) if byte != 0xFF)
    for at in range(start, start + 8):
        board.received.clear()
        now = board.now
        board.order("eeprom", now, at, f"{kept[at] ^ 0x10:02x}")
        board.order("reset", now + 1)
        board.hear(b"?\n", now + 100 * MS)
        board.order("eeprom", now + 150 * MS, at, f"{kept[at]:02x}")
        board.run(now + 200 * MS)
        assert of(CameraPulses, board) == [CameraPulses(delay_us=0, pulse_us=100, places=16, unmade=0)]


def test_a_reset_while_the_delay_is_written_leaves_the_old_one_the_new_one_or_none(board: Board) -> None:
    seen = set()
    delayed(board, 11_111, 111)
    for after_us in range(1750, 2100, 7):  # simavr writes in microseconds what takes the chip 27 ms
        board.received.clear()
        now = board.now
        board.hear(set_pulses(FALL_US, 222), now)
        board.order("reset", now + after_us * US)
        board.hear(b"?\n", now + 200 * MS)
        board.run(now + 230 * MS)
        told = of(CameraPulses, board)[-1]
        seen.add((told.delay_us, told.pulse_us))
        board.hear(set_pulses(11_111, 111), board.now)
        board.run(board.now + 100 * MS)
    assert seen == {(11_111, 111), (0, 100), (FALL_US, 222)}


@pytest.mark.parametrize("how", ["reset", "hang"])
def test_after_a_reset_it_counts_anew_and_makes_none_of_the_pulses_that_waited(
    board: Board, how: str
) -> None:
    """In flight: one pulse up, one waiting; the program that hangs is started anew by the watchdog."""
    delayed(board, FALL_US, 900)
    at = START + 100 * MS
    board.stone(at, width=MS)
    board.stone(at + 100 * MS, width=MS)
    board.order(how, at + FALL_US * US + (400 * US if how == "reset" else -600 * MS // 10))
    board.stone(at + 1500 * MS, width=MS)
    board.run(at + 3 * HZ)
    assert [edge.sequence for edge in of(Edge, board)] == [1, 2, 1]
    first, _, third = of(Edge, board)
    assert third.device_us < first.device_us + 1_500_000
    assert of(Status, board)[-1].last_sequence == 1
    closings, rises = board.rises("beam"), board.rises("trigger")
    assert_exact([rises[-1] - closings[2]], FALL_US)
    if how == "reset":
        assert len(rises) == 2
        assert abs(board.widths("trigger")[0] - 400 * US) < 20
    else:
        assert len(rises) == 4 - 1, "interrupts go on until the watchdog strikes: both pulses were made"


def test_half_a_second_without_the_main_loop_is_what_the_watchdog_waits(board: Board) -> None:
    board.order("hang", 100 * MS)
    board.run(590 * MS)
    board.received.clear()
    board.run(1700 * MS)
    assert [status.device_us // 100_000 for status in of(Status, board)] == [10]
    assert 1590 * MS < board.received[0][0] < 1640 * MS


@pytest.mark.parametrize(
    ("turns", "eras", "passed_us"),
    [
        (0xFFF0, 0, 0xFFF0 << 12),  # 16 bits of turns: cycles of 32 bits wrap
        ((1 << 20) - 16, 0, (1 << 32) - (16 << 12)),  # microseconds of 32 bits wrap
        ((1 << 32) - 16, 0, (1 << 44) - (16 << 12)),  # turns of 32 bits wrap
        ((1 << 32) - 16, (1 << 20) - 2, (1 << 64) - (1 << 44) - (16 << 12)),  # the last 203 days of 64 bits
    ],
)
def test_the_clock_goes_on_over_its_wraps(board: Board, turns: int, eras: int, passed_us: int) -> None:
    delayed(board, 40_000)
    build, now = board.build, board.now
    board.order("memory", now, build.address("turns"), turns.to_bytes(4, "little").hex())
    board.order("memory", now, build.address("eras"), eras.to_bytes(4, "little").hex())
    for n in range(30):
        board.stone(now + 10 * MS + n * 5 * MS + n * 11, width=2 * MS)
    board.run(now + 300 * MS)
    edges, closings = of(Edge, board), board.rises("beam")
    assert len(edges) == 30
    assert abs(edges[0].device_us - passed_us - 10_000) < 5000
    for edge, closing in zip(edges, closings, strict=True):
        assert abs(edge.device_us - edges[0].device_us - (closing - closings[0]) / US) <= 1
    assert {width.width_us for width in of(Width, board)} <= {2000, 2001}
    made = [rise - close for close, rise in zip(closings, board.rises("trigger"), strict=False)]
    assert_exact(made, 40_000)


def test_numbers_go_on_over_their_wrap(board: Board) -> None:
    board.run(START)
    board.order("memory", board.now, board.build.address("sequence"), "feffffff")
    for n in range(4):
        board.stone(100 * MS + n * 10 * MS, width=2 * MS)
    board.run(1100 * MS)
    assert [edge.sequence for edge in of(Edge, board)] == [4294967295, 0, 1, 2]
    assert of(Status, board)[-1].last_sequence == 2


def test_more_edges_than_the_line_carries_are_lost_from_lines_and_never_from_the_count(board: Board) -> None:
    """Stones 2.2 ms apart need more than 115200 baud; numbers and statuses tell the host what it lost."""
    for n in range(400):
        board.stone(100 * MS + n * 22 * MS // 10, width=MS)
    board.run(2100 * MS)
    told = [edge.sequence for edge in of(Edge, board)]
    assert told == sorted(set(told))
    assert len(told) < 400
    last = 0
    for record in board.records():
        if isinstance(record, Edge):
            last = record.sequence
        elif isinstance(record, Status) and record.last_sequence < 400:
            assert record.last_sequence == last, "no edge whose line comes after it"
    assert of(Status, board)[-1].last_sequence == 400
    assert {width.sequence for width in of(Width, board)} <= set(told)
    assert_exact(delays(board), LEAST_US)


def test_the_driver_hears_stones_bounces_and_test_pulses_and_sets_the_delay(
    board: Board, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for wait in ("ASK_AGAIN_S", "TEST_PULSE_S"):  # a busy machine emulates late
        monkeypatch.setattr(serial_gate, wait, 20.0)
    board.run(START)
    settings = SerialGateSettings(
        port=str(tmp_path / "gate"), debounce_us=1, silence_s=PATIENCE_S, answer_timeout_s=PATIENCE_S
    )
    gate, sink = SerialGate(settings, delay_us=FALL_US), Collector()

    def stones(now: int) -> None:
        for n in range(20):
            board.stone(now + n * 7 * MS, width=3 * MS)
        board.stone(now + 20 * 7 * MS, width=3 * MS)
        board.stone(now + 20 * 7 * MS + 3 * MS + MS // 2, width=MS)

    with BoardOnPort(board, tmp_path / "gate") as port:
        try:
            gate.open()
            assert gate.identity is not None
            assert gate.identity.name == FIRMWARE_NAME
            assert gate.pulses == CameraPulses(delay_us=FALL_US, pulse_us=100, places=16, unmade=0)
            gate.arm(sink)
            port.soon(stones)
            eventually(lambda: gate.counters.ignored == 1 and len(board.rises("trigger")) == 16)
            gate.test_pulse()
            triggers = [event for event in sink.events if isinstance(event, Trigger)]
            assert [trigger.sequence for trigger in triggers] == list(range(1, 23))
            assert triggers[-1].kind is BundleKind.BACKGROUND
            apart = [(b.device_ns - a.device_ns) / 1000 for a, b in pairwise(triggers[:21])]
            assert all(abs(each - 7000) <= 1 for each in apart)
            ends = [event for event in sink.events if isinstance(event, PulseEnded)]
            assert [round(end.width_ns / 1e5) for end in ends] == [30] * 20 + [45]
            assert [event.count for event in sink.events if isinstance(event, TriggersIgnored)] == [1]
            assert gate.counters.garbage == gate.counters.missed == gate.counters.restarts == 0
            assert gate.pulses.unmade == 20 + 1 - 16
            assert_exact(
                [b - a for a, b in zip(board.rises("beam"), board.rises("trigger"), strict=False)], FALL_US
            )
            gate.close()  # a host that starts again finds the numbers where they were
            gate.open()
            gate.arm(again := Collector())
            port.soon(lambda now: board.stone(now))
            trigger = again.next()
            assert isinstance(trigger, Trigger)
            assert trigger.sequence == 23
            port.soon(lambda now: board.order("reset", now))
            port.soon(lambda now: board.stone(now + 100 * MS))
            eventually(lambda: gate.counters.restarts == 1)
        finally:
            gate.close()
