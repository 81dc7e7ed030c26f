"""The simulated light gate, read through a real serial library."""

import os
import random
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
import serial
from support.eventually import eventually

from drivers.gates.gate_protocol import IDENTIFY, TEST_PULSE, decode, set_pulses
from drivers.gates.gate_records import CameraPulses, Edge, Identity, Record, Status, TestPulse, Width
from drivers.gige_simulator.gate import GateDesign, SimulatedGate
from drivers.gige_simulator.gate_faults import GateFaults, damaged

WIDTH_NS = 5_000_000
LINE = b"$E,12,3456*2C05\r\n"


def dice() -> random.Random:
    return random.Random(1)  # noqa: S311 - repeatable


class Bench:
    """A gate, its trigger line, and the host's port."""

    def __init__(self, link: Path, *, drift_ppm: float = 0.0, places: int = 8) -> None:
        self.pulses: list[int] = []
        self.empty: list[int] = []
        self.gate = SimulatedGate(
            GateDesign(link=link, clock_drift_ppm=drift_ppm, places=places),
            pulse=self.pulses.append,
            empty_rig=self.empty.append,
        )
        self.link = link
        self.gate.open()
        self.plug_in()

    def plug_in(self) -> None:
        self.port = serial.Serial(str(self.link), timeout=3, exclusive=True)
        eventually(lambda: self.gate.is_opened)

    def stone(self, width_ns: int = WIDTH_NS) -> int:
        edge_ns = time.monotonic_ns()
        self.gate.interrupt(edge_ns, width_ns)
        return edge_ns

    def line(self) -> bytes:
        line = self.port.readline()
        assert line, "the gate says nothing"
        return line

    def heard(self) -> Record:
        """The next record that is not the status of a second."""
        while isinstance(record := decode(self.line()), Status):
            pass
        return record

    def status(self) -> Status:
        while not isinstance(record := decode(self.line()), Status):
            pass
        return record

    def close(self) -> None:
        self.port.close()
        self.gate.close()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with closing(Bench(tmp_path / "gate")) as bench:
        yield bench


def test_a_stone_is_pulsed_and_told(bench: Bench) -> None:
    edges_ns = [bench.stone() for _ in range(3)]
    assert bench.pulses == edges_ns
    told = [bench.heard() for _ in range(6)]
    edges = [record for record in told if isinstance(record, Edge)]
    assert [edge.sequence for edge in edges] == [1, 2, 3]
    spacing_us = (edges_ns[2] - edges_ns[0]) / 1000
    assert edges[2].device_us - edges[0].device_us == pytest.approx(spacing_us, abs=2)
    assert [record for record in told if isinstance(record, Width)] == [Width(n, 5000) for n in (1, 2, 3)]


def test_its_clock_drifts(tmp_path: Path) -> None:
    with closing(Bench(tmp_path / "gate", drift_ppm=1000)) as bench:
        bench.stone(width_ns=500_000_000)
        assert isinstance(bench.heard(), Edge)
        width = bench.heard()
        assert isinstance(width, Width)
        assert width.width_us == pytest.approx(500_500, abs=1)


def test_commands(bench: Bench) -> None:
    bench.port.write(b"nonsense\n" + IDENTIFY + TEST_PULSE)
    assert bench.heard() == Identity(name="stonefall-simulated-gate", serial="SIM-GATE", version="1")
    assert bench.heard() == CameraPulses(delay_us=0, pulse_us=100, places=8, unmade=0)
    assert isinstance(pulse := bench.heard(), TestPulse)
    assert pulse.sequence == 1
    assert bench.pulses == bench.empty
    assert len(bench.empty) == 1


def test_pulses_come_after_the_delay_that_is_set_and_those_without_a_place_never(tmp_path: Path) -> None:
    with closing(Bench(tmp_path / "gate", places=2)) as bench:
        bench.port.write(set_pulses(300_000, 50))
        assert bench.heard() == CameraPulses(delay_us=300_000, pulse_us=50, places=2, unmade=0)
        edges_ns = [bench.stone() for _ in range(3)]
        assert bench.pulses == []
        told = [bench.heard() for _ in range(4)]
        assert [record.sequence for record in told if isinstance(record, Edge)] == [1, 2, 3]
        unmade_at = told.index(CameraPulses(delay_us=300_000, pulse_us=50, places=2, unmade=1))
        assert any(isinstance(record, Edge) and record.sequence == 3 for record in told[:unmade_at])
        bench.port.write(set_pulses(0, 50))  # pulses that wait keep their time
        eventually(lambda: len(bench.pulses) == 2)
        assert bench.pulses == [edge_ns + 300_000_000 for edge_ns in edges_ns[:2]]
        assert bench.gate.counters.unmade == 1


def test_a_delay_that_it_cannot_make_changes_nothing_and_one_that_it_can_outlives_its_power(
    bench: Bench,
) -> None:
    wanted = CameraPulses(delay_us=2000, pulse_us=100, places=8, unmade=0)
    for command in (set_pulses(2000, 100), set_pulses(1 << 31, 100), set_pulses(1000, 1)):
        bench.port.write(command)
        assert bench.heard() == wanted
    bench.port.write(set_pulses(5000, 100).replace(b"5000", b"5001"))  # damaged
    bench.port.close()
    bench.gate.power_cycle(0.05)
    eventually(lambda: not bench.link.exists())
    eventually(bench.link.exists)
    bench.plug_in()
    bench.port.write(IDENTIFY)
    while not isinstance(record := bench.heard(), CameraPulses):
        pass
    assert record == wanted


def test_a_bounce_is_merged(bench: Bench) -> None:
    bench.gate.faults.bounce = 1.0
    bench.stone()
    eventually(lambda: bench.gate.counters.merged == 1)
    status = bench.status()
    assert (status.last_sequence, status.ignored, status.is_blocked) == (1, 1, False)
    assert len(bench.pulses) == 1


def test_a_doubled_stone_is_two(bench: Bench) -> None:
    bench.gate.faults.doubled = 1.0
    bench.stone()
    told = [bench.heard() for _ in range(4)]
    assert [type(record) for record in told] == [Edge, Width, Edge, Width]
    assert bench.pulses[1] - bench.pulses[0] == 3_000_000


def test_what_the_gate_misses(bench: Bench) -> None:
    faults = bench.gate.faults
    faults.set("missed", 1)
    bench.stone()
    faults.clear()
    faults.is_blocked = True
    bench.stone()
    assert bench.status().is_blocked
    faults.clear()
    faults.uncounted = 1.0
    bench.stone()
    faults.clear()
    bench.stone()
    assert isinstance(edge := bench.heard(), Edge)
    assert edge.sequence == 1
    counters = bench.gate.counters
    assert (counters.missed, counters.uncounted, counters.edges, len(bench.pulses)) == (2, 1, 1, 2)


def test_a_line_lost_leaves_a_gap(bench: Bench) -> None:
    bench.gate.faults.lost = 1.0
    bench.stone()
    eventually(lambda: bench.gate.counters.damaged_lines >= 2)
    bench.gate.faults.clear()
    bench.stone()
    assert isinstance(edge := bench.heard(), Edge)
    assert edge.sequence == 2


def test_latency_keeps_the_order(bench: Bench) -> None:
    bench.gate.faults.jitter_us = 20_000
    for _ in range(10):
        bench.stone(width_ns=100_000)
    edges = [record for record in (bench.heard() for _ in range(20)) if isinstance(record, Edge)]
    assert [edge.sequence for edge in edges] == list(range(1, 11))
    assert edges[-1].device_us - edges[0].device_us < 20_000


def test_without_a_plug_it_counts_on(bench: Bench, tmp_path: Path) -> None:
    bench.stone()
    assert isinstance(bench.heard(), Edge)
    bench.gate.unplug()
    with pytest.raises(serial.SerialException):
        bench.port.read(100)
    bench.port.close()
    eventually(lambda: not os.path.lexists(tmp_path / "gate"))
    bench.stone()
    bench.gate.plug()
    eventually((tmp_path / "gate").exists)
    bench.plug_in()
    assert bench.status().last_sequence == 2
    assert len(bench.pulses) == 2


def test_without_power_it_forgets(bench: Bench, tmp_path: Path) -> None:
    bench.stone()
    bench.gate.power_cycle(0.1)
    bench.stone()
    bench.port.close()
    eventually(lambda: not os.path.lexists(tmp_path / "gate"))
    eventually((tmp_path / "gate").exists)
    bench.plug_in()
    bench.stone()
    edge = bench.heard()
    assert isinstance(edge, Edge)
    assert edge.sequence == 1
    assert edge.device_us < 10_000_000
    assert bench.gate.counters.missed == 1


def test_nobody_listens(bench: Bench) -> None:
    bench.port.close()
    eventually(lambda: not bench.gate.is_opened)
    bench.stone()
    eventually(lambda: bench.gate.counters.unheard_lines >= 2)
    bench.plug_in()
    bench.stone()
    assert isinstance(edge := bench.heard(), Edge)
    assert edge.sequence == 2


@pytest.mark.parametrize(
    ("faults", "left", "is_whole"),
    [
        (GateFaults(), LINE, True),
        (GateFaults(lost=1.0), b"", False),
        (GateFaults(is_silent=True), b"", False),
        (GateFaults(halved=1.0), LINE[: len(LINE) // 2], False),
        (GateFaults(repeated=1.0), LINE * 2, True),
    ],
)
def test_what_becomes_of_a_line(faults: GateFaults, left: bytes, is_whole: bool) -> None:
    assert damaged(LINE, faults, dice()) == (left, is_whole)


def test_noise_and_wrong_characters() -> None:
    with_noise, is_whole = damaged(LINE, GateFaults(garbage=1.0), dice())
    assert with_noise.endswith(LINE)
    assert len(with_noise) > len(LINE)
    assert is_whole
    corrupted, is_whole = damaged(LINE, GateFaults(corrupted=1.0), dice())
    assert sum(a != b for a, b in zip(corrupted, LINE, strict=True)) == 1
    assert not is_whole


def test_faults_repeat_with_the_seed_and_do_not_move_each_other() -> None:
    def struck(faults: GateFaults) -> list[bool]:
        same = dice()
        return [damaged(LINE, faults, same)[0] == b"" for _ in range(100)]

    assert struck(GateFaults(lost=0.3)) == struck(GateFaults(lost=0.3, garbage=0.5, repeated=0.5))
    assert 15 < sum(struck(GateFaults(lost=0.3))) < 45
