"""The light gate of the simulated rig: a microcontroller that speaks `gate_protocol` on a pseudo-terminal.

It counts the stones that close its beam, reports to the host and pulses the cameras' trigger line, at once or after the
delay that the host has set; that is kept without power. Its clock drifts, and pulling its plug does not cut its power.
Gates on modem lines cannot be simulated: a pseudo-terminal has no such line.
"""

import heapq
import os
import random
import select
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path

from drivers.gates.gate_protocol import IDENTIFY, TEST_PULSE, encode, read_set_pulses
from drivers.gates.gate_records import (
    SEQUENCES,
    CameraPulses,
    Edge,
    Identity,
    Record,
    Status,
    TestPulse,
    Width,
)
from drivers.gige_simulator.gate_faults import GateFaults, damaged
from drivers.gige_simulator.pseudo_terminal import PseudoTerminal

STATUS_NS = 1_000_000_000
UNOPENED_POLL_NS = 20_000_000
"""Interval of polling until a host opens the pseudo-terminal, which does not report that."""
BOUNCE_NS = 3_000_000
"""From the opening of the beam to the bounce, and from one edge of a doubled stone to the other."""
LONGEST_DELAY_US = 4_000_000
SHORTEST_PULSE_US, LONGEST_PULSE_US = 10, 10_000
GAP_NS = 1_000_000
"""How long the beam is open between the two pulses of a doubled stone."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GateDesign:
    """The properties of a simulated gate."""

    link: Path  # symbolic link that the host opens as the serial port
    serial: str = "SIM-GATE"
    clock_drift_ppm: float = 0.0
    places: int = 8  # pulses to the cameras that can wait; 0: an old one, which cannot delay
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedGateCounters:
    """Counts of a simulated gate's actions since it was made."""

    edges: int = 0  # counted
    test_pulses: int = 0
    merged: int = 0  # bounces
    missed: int = 0  # stones neither counted nor pulsed: by fault, blocked beam or without power
    uncounted: int = 0  # stones that pulsed the cameras only
    pulses: int = 0  # on the cameras' trigger line
    unmade: int = 0  # pulses for which no place was free
    lines: int = 0  # sent whole
    damaged_lines: int = 0  # lost, halved, corrupted or silenced
    unheard_lines: int = 0  # while no host had the port open


class SimulatedGate:
    """A light gate that is powered from `open` to `close`, with one thread.

    `pulse` is the cameras' trigger line; `empty_rig` is called before it when the host asks for a test pulse. Both
    take the time (monotonic ns) and are called on the gate's thread or on the one that calls `interrupt`.
    """

    def __init__(
        self, design: GateDesign, *, pulse: Callable[[int], None], empty_rig: Callable[[int], None]
    ) -> None:
        self.faults = GateFaults()
        self.counters = SimulatedGateCounters()
        self._design = design
        self._pulse = pulse
        self._empty_rig = empty_rig
        self._port = PseudoTerminal(design.link)
        self._input = b""
        self._lock = threading.RLock()
        self._is_powered = False
        self._power_on_ns = 0
        self._sequence = 0
        self._ignored = 0
        self._pulses = CameraPulses(delay_us=0, pulse_us=100, places=design.places, unmade=0)
        self._n_waiting = 0
        self._plans: list[tuple[int, int, Callable[[], None]]] = []  # heap of (due_ns, order, action)
        self._order = count()
        self._last_line_ns = 0
        # edges and each kind of line have their own random numbers: no fault shifts those of the others
        self._dice: dict[type[Record] | None, random.Random] = {
            kind: random.Random(f"{design.seed}/gate/{kind and kind.__name__}")  # noqa: S311 - nothing secret
            for kind in (None, Edge, TestPulse, Width, Status, Identity, CameraPulses)
        }
        self.is_opened = False
        """Whether a host has the port open."""
        self._is_closing = threading.Event()
        self._wake_fd = -1
        self._thread = threading.Thread(target=self._run, name="simulated gate", daemon=True)

    # --- power and plug ---

    def open(self) -> None:
        """Power on and plug in.

        Raises
        ------
        GateUnavailableError
            The link cannot be made.
        """
        self._port.plug()
        self._wake_fd = os.eventfd(0, os.EFD_NONBLOCK)
        self._power_on()
        self._thread.start()

    def close(self) -> None:
        if self._wake_fd < 0:
            return
        self._plan(0, self._is_closing.set)
        self._thread.join()
        self._port.unplug()
        os.close(self._wake_fd)
        self._wake_fd = -1

    def unplug(self, seconds: float | None = None) -> None:
        """Pull the serial plug, for `seconds` or until `plug`; the gate goes on counting and pulsing."""
        now_ns = time.monotonic_ns()
        self._plan(now_ns, self._port.unplug)
        if seconds is not None:
            self._plan(now_ns + round(seconds * 1e9), self._plug)

    def plug(self) -> None:
        """Put the serial plug in again."""
        self._plan(time.monotonic_ns(), self._plug)

    def power_cycle(self, seconds: float = 1.0) -> None:
        """Cut the power for `seconds`: no stone is seen meanwhile, and counter and clock begin anew."""
        now_ns = time.monotonic_ns()
        with self._lock:
            self._is_powered = False
            self._plans.clear()
            self._n_waiting = 0
            self._pulses = replace(self._pulses, unmade=0)
            self._plan(now_ns, self._port.unplug)
            self._plan(now_ns + round(seconds * 1e9), self._power_on)

    def count_unheard(self, n_stones: int, seconds: float) -> None:
        """Go on as if `n_stones` had fallen within `seconds` in which no host listened."""
        with self._lock:
            self._power_on_ns -= round(seconds * 1e9)
            self._sequence = (self._sequence + n_stones) % SEQUENCES

    def _plug(self) -> None:
        if self._is_powered:
            self._port.plug()

    def _power_on(self) -> None:
        with self._lock:
            self._is_powered = True
            self._power_on_ns = time.monotonic_ns()
            self._sequence = self._ignored = 0
            self._port.plug()
            self._plan(self._power_on_ns + STATUS_NS, self._tell_status)

    # --- the beam ---

    def interrupt(self, edge_ns: int, width_ns: int) -> None:
        """Let a stone close the beam at `edge_ns`, which is now, and leave it after `width_ns`."""
        faults, dice = self.faults, self._dice[None]
        missed, uncounted, bounced, doubled = (
            dice.random() < p for p in (faults.missed, faults.uncounted, faults.bounce, faults.doubled)
        )
        if missed or faults.is_blocked or not self._is_powered:
            self._count(missed=1)
        elif uncounted:
            self._count(uncounted=1)
            self._pulse_cameras(edge_ns)
        elif doubled:
            self._close_beam(edge_ns, BOUNCE_NS - GAP_NS)
            rest_ns = max(width_ns - BOUNCE_NS, GAP_NS)
            self._plan(edge_ns + BOUNCE_NS, partial(self._close_beam, edge_ns + BOUNCE_NS, rest_ns))
        else:
            self._close_beam(edge_ns, width_ns)
            if bounced:
                self._plan(edge_ns + width_ns + BOUNCE_NS, self._merge)

    def test_pulse(self, at_ns: int) -> None:
        """Pulse the cameras without a stone, and count it."""
        if not self._is_powered:
            self._count(missed=1)
            return
        is_made = self._pulse_cameras(at_ns)
        with self._lock:
            self._count(test_pulses=1)
            self._say(TestPulse(self._next_sequence(), self._microseconds(at_ns)))
            if not is_made:
                self._say(self._pulses)

    def _close_beam(self, edge_ns: int, width_ns: int) -> None:
        is_made = self._pulse_cameras(edge_ns)
        with self._lock:
            self._count(edges=1)
            sequence = self._next_sequence()
            self._say(Edge(sequence, self._microseconds(edge_ns)))
            if not is_made:
                self._say(self._pulses)
            width_us = self._microseconds(edge_ns + width_ns) - self._microseconds(edge_ns)
            self._plan(edge_ns + width_ns, partial(self._say, Width(sequence, width_us)))

    def _merge(self) -> None:
        with self._lock:
            self._ignored = (self._ignored + 1) % SEQUENCES
            self._count(merged=1)

    def _pulse_cameras(self, at_ns: int) -> bool:
        """Pulse the cameras' trigger line once the delay after `at_ns` is over; False when no place is free for it."""
        with self._lock:
            due_ns = at_ns + self._pulses.delay_us * 1000
            if due_ns > at_ns and self._n_waiting >= self._pulses.places:
                self._count(unmade=1)
                self._pulses = replace(self._pulses, unmade=(self._pulses.unmade + 1) % SEQUENCES)
                return False
            self._n_waiting += 1
            if due_ns > at_ns:
                self._plan(due_ns, partial(self._make_pulse, due_ns))
                return True
        self._make_pulse(at_ns)
        return True

    def _make_pulse(self, at_ns: int) -> None:
        with self._lock:
            self._n_waiting -= 1
        self._count(pulses=1)
        self._pulse(at_ns)

    def _set_pulses(self, delay_us: int, pulse_us: int) -> None:
        if delay_us <= LONGEST_DELAY_US and SHORTEST_PULSE_US <= pulse_us <= LONGEST_PULSE_US:
            self._pulses = replace(self._pulses, delay_us=delay_us, pulse_us=pulse_us)
        self._say(self._pulses)

    def _next_sequence(self) -> int:
        self._sequence = (self._sequence + 1) % SEQUENCES
        return self._sequence

    def _microseconds(self, at_ns: int) -> int:
        return round((at_ns - self._power_on_ns) * (1 + self._design.clock_drift_ppm * 1e-6) / 1000)

    # --- the line ---

    def _tell_status(self) -> None:
        with self._lock:
            if not self._is_powered:
                return
            self._plan(time.monotonic_ns() + STATUS_NS, self._tell_status)
            self._say_status()

    def _say_status(self) -> None:
        with self._lock:
            now_ns = time.monotonic_ns()
            self._say(
                Status(
                    device_us=self._microseconds(now_ns),
                    last_sequence=self._sequence,
                    ignored=self._ignored,
                    is_blocked=self.faults.is_blocked,
                )
            )

    def _say(self, record: Record) -> None:
        """Send a record, or what the faults make of it; lines keep their order."""
        dice = self._dice[type(record)]
        line, is_whole = damaged(encode(record), self.faults, dice)
        late_ns = round(dice.random() * self.faults.jitter_us * 1000)
        with self._lock:
            self._last_line_ns = max(time.monotonic_ns() + late_ns, self._last_line_ns)
            self._plan(self._last_line_ns, partial(self._send, line, is_whole))

    def _send(self, line: bytes, is_whole: bool) -> None:
        if not self._port.write(line):
            self._count(unheard_lines=1)
        elif is_whole:
            self._count(lines=1)
        else:
            self._count(damaged_lines=1)

    def _listen(self) -> None:
        *commands, self._input = (self._input + self._port.read())[-64:].split(b"\n")
        for command in commands:
            if command + b"\n" == TEST_PULSE:
                now_ns = time.monotonic_ns()
                self._empty_rig(now_ns)
                self.test_pulse(now_ns)
            elif command + b"\n" == IDENTIFY:
                self._say(Identity(name="stonefall-simulated-gate", serial=self._design.serial, version="1"))
                if self._pulses.places:
                    self._say(self._pulses)
                self._say_status()
            elif self._pulses.places:
                with suppress(ValueError):
                    self._set_pulses(*read_set_pulses(command))

    # --- the thread, which alone uses the port ---

    def _plan(self, due_ns: int, action: Callable[[], None]) -> None:
        with self._lock:
            heapq.heappush(self._plans, (due_ns, next(self._order), action))
            if self._wake_fd >= 0:
                os.eventfd_write(self._wake_fd, 1)

    def _count(self, **more: int) -> None:
        with self._lock:
            counters = self.counters
            self.counters = replace(
                counters, **{name: getattr(counters, name) + n for name, n in more.items()}
            )

    def _run(self) -> None:
        while not self._is_closing.is_set():
            self._wait()
            while (action := self._due_action()) is not None:
                action()
            self.is_opened = self._port.is_opened
            self._listen()

    def _wait(self) -> None:
        """Wait until an action is due or the host sent something."""
        with self._lock:
            wait_ns = self._plans[0][0] - time.monotonic_ns() if self._plans else STATUS_NS
        fds = [self._wake_fd]
        if self.is_opened:
            fds.append(self._port.fileno())
        else:
            wait_ns = min(wait_ns, UNOPENED_POLL_NS)
        readable, _, _ = select.select(fds, [], [], max(wait_ns, 0) / 1e9)
        if self._wake_fd in readable:
            os.eventfd_read(self._wake_fd)

    def _due_action(self) -> Callable[[], None] | None:
        with self._lock:
            if self._plans and self._plans[0][0] <= time.monotonic_ns():
                return heapq.heappop(self._plans)[2]
        return None
