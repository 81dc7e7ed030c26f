"""A light gate on a pseudo-terminal: the device side of `SerialGate`, driven edge by edge by a test."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
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
from drivers.gates.serial_gate import SerialGate, SerialGateSettings
from drivers.gige_simulator.pseudo_terminal import PseudoTerminal


def pty_settings(link: Path) -> SerialGateSettings:
    """For a gate that transmits at once, as native USB does, and stones that follow one another at once."""
    return SerialGateSettings(port=str(link), baud=4_000_000, debounce_us=1)


@contextmanager
def serial_gate(link: Path, *, delay_us: int = 0) -> Iterator[tuple[SerialGate, "PtyGate"]]:
    """Make a serial gate, not yet opened, and the device it will find; both end with the context."""
    device = PtyGate(link)
    gate = SerialGate(pty_settings(link), delay_us=delay_us)
    try:
        yield gate, device
    finally:
        gate.close()
        device.unplug()


UPTIME_NS = 60_000_000_000
"""For so long it has been on when it is made."""
LOOK_S = 0.002


class PtyGate:
    """Answers commands; edges, statuses, bytes and silence are the test's.

    `link` is the stable name: a symbolic link, the same after `unplug` and `plug`. What it sends it sends at once,
    to nobody when no host has the port open.
    """

    def __init__(self, link: Path, *, first_sequence: int = 1) -> None:
        self.link = link
        self.last_sequence = (first_sequence - 1) % SEQUENCES
        self.ignored = 0
        self.is_blocked = False
        self.answers = True
        self.pulses: CameraPulses | None = None  # None: an old one, which cannot delay
        self.longest_delay_us = 4_000_000
        self.identity = Identity(name="pty-gate", serial="7", version="1.0")
        self._booted_ns = time.monotonic_ns() - UPTIME_NS
        self._sending = threading.Lock()
        self._stopping = threading.Event()
        self._port = PseudoTerminal(link)
        self._thread: threading.Thread | None = None
        self.plug()

    def plug(self) -> None:
        """Appear under the link."""
        self._port.plug()
        self._stopping.clear()
        self._thread = threading.Thread(target=self._obey, daemon=True, name="pty gate")
        self._thread.start()

    def unplug(self) -> None:
        """Vanish; idempotent."""
        if self._thread is None:
            return
        self._stopping.set()
        self._thread.join()
        self._thread = None
        with self._sending:
            self._port.unplug()

    def restart(self) -> None:
        """Forget time and numbers, as at a loss of power."""
        self._booted_ns = time.monotonic_ns()
        self.last_sequence = self.ignored = 0

    @property
    def device_us(self) -> int:
        return (time.monotonic_ns() - self._booted_ns) // 1000

    def host_ns(self, device_us: int) -> int:
        """Monotonic time of the gate's `device_us`."""
        return self._booted_ns + device_us * 1000

    def edge(self, *, width_us: int | None = None, is_told: bool = True, at_us: int | None = None) -> Edge:
        """Count a stone; unless `is_told` no line says so."""
        edge = Edge(self._count(), self.device_us if at_us is None else at_us)
        if is_told:
            self.send(edge)
            if width_us is not None:
                self.send(Width(edge.sequence, width_us))
        return edge

    def status(self) -> None:
        self.send(
            Status(
                device_us=self.device_us,
                last_sequence=self.last_sequence,
                ignored=self.ignored,
                is_blocked=self.is_blocked,
            )
        )

    def send(self, record: Record) -> None:
        self.send_bytes(encode(record))

    def send_bytes(self, data: bytes) -> None:
        with self._sending:
            self._port.write(data)

    def _count(self) -> int:
        self.last_sequence = (self.last_sequence + 1) % SEQUENCES
        return self.last_sequence

    def _obey(self) -> None:
        received = b""
        while not self._stopping.wait(LOOK_S):
            received += self._port.read()
            *commands, received = received.split(b"\n")
            for command in commands:
                self._answer(command + b"\n")

    def _answer(self, command: bytes) -> None:
        if not self.answers:
            return
        if command == IDENTIFY:
            self.send(self.identity)
            self._send_pulses()
            self.status()
        elif command == TEST_PULSE:
            self.send(TestPulse(self._count(), self.device_us))
        elif self.pulses is not None:
            delay_us, pulse_us = read_set_pulses(command)
            if delay_us <= self.longest_delay_us:
                self.pulses = replace(self.pulses, delay_us=delay_us, pulse_us=pulse_us)
            self._send_pulses()

    def _send_pulses(self) -> None:
        if self.pulses is not None:
            self.send(self.pulses)
