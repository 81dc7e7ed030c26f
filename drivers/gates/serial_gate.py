"""A light gate with a microcontroller on a serial line, which speaks `gate_protocol`, or another protocol."""

import termios
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import serial

from drivers.errors import DeviceFault, Told, told
from drivers.files.times import ns_since
from drivers.gates.gate_listener import GateListener
from drivers.gates.gate_protocol import FIRMWARE_VERSION, STONEFALL, is_outdated
from drivers.gates.gate_records import CameraPulses, GateProtocol, Identity
from drivers.gates.gate_thread import GateThread
from drivers.gates.port import keep_port, port_problem
from drivers.gates.reception import GateCounters
from drivers.interfaces import DeviceEvent, EventSink, TriggersLost
from pipeline.frames import BundleKind, GateCount, Trigger

READ_S = 0.02
"""Time-out of a read; after each the end of a pulse and the silence of the gate are checked."""
ASK_AGAIN_S = 0.5
"""How long an answer to `IDENTIFY` is waited for before it is sent again."""
SET_TRIES = 3
"""How often the delay is set before the gate counts as one that cannot make it; a line may be damaged."""
WRITE_S = 0.5
TEST_PULSE_S = 0.5
"""Longest time from the command for a test pulse to the gate's answer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialGateSettings:
    """The port of the gate, and the times after which it counts as lost or blocked."""

    port: str  # a name that outlives replugging: /dev/serial/by-id/...
    baud: int = 115_200  # a board with native USB has none: 4000000
    debounce_us: int = 10_000  # edges within this time after the last one belong to the same stone
    answer_timeout_s: float = 3.0  # for its first status; a board that restarts when it is opened needs 2
    silence_s: float = 3.0  # lost after so long without a valid line; it sends a status every second
    pulse_us: int = 100  # width of its pulses to the cameras, where it can be set
    blocked_s: float = 2.0  # a beam closed for longer is blocked: no stone takes so long

    def __post_init__(self) -> None:
        if not self.port:
            raise ValueError("port must be named, as under /dev/serial/by-id/")
        if not 300 <= self.baud <= 12_000_000:
            raise ValueError(f"baud must be in 300..12000000, not {self.baud}")
        if self.debounce_us < 0:
            raise ValueError(f"debounce_us must not be negative, not {self.debounce_us}")
        if not 1 <= self.pulse_us <= 100_000:
            raise ValueError(f"pulse_us must be in 1..100000, not {self.pulse_us}")
        if self.answer_timeout_s <= 0 or self.blocked_s <= 0:
            raise ValueError("answer_timeout_s and blocked_s must be positive")
        if self.silence_s <= 1:
            raise ValueError(f"silence_s must exceed the second between two statuses, not {self.silence_s:g}")


class SerialGate:
    """A `LightGate` that delivers `Trigger`, `PulseEnded`, `TriggersIgnored`, `TriggersLost` and, once, `GateLost`.

    `received_ns` is when the beam closed: when its line was read, less its transmission and less the latency that
    the gate's own clock reveals. Sequence numbers are the gate's, counted on when it restarts.

    What the gate counted and did not announce is `TriggersLost`; when an armed gate was lost, or the process that had
    armed it, also what it counted until it was armed again. What passes a gate disarmed on purpose is not lost.

    `delay_us` is what the gate waits from an edge to its pulse to the cameras; it is set when the gate is opened, and a
    gate that does otherwise is not used.
    """

    def __init__(
        self, settings: SerialGateSettings, protocol: GateProtocol = STONEFALL, *, delay_us: int = 0
    ) -> None:
        self._settings = settings
        self._delay_us = delay_us
        self._protocol = protocol
        self._thread = GateThread(settings.port)
        self._port: serial.Serial | None = None
        self._listener = GateListener(protocol, baud=settings.baud, debounce_ns=settings.debounce_us * 1000)
        self._heard = threading.Condition()  # guards the listener and all below
        self._heard_ns = 0
        self._is_answered = False  # since it was opened; only then silence is a loss
        self._is_owed = False  # the gate was armed and not disarmed before it was lost: report what it counts
        self._n_owed = 0
        self._was_down = False  # an earlier process had armed it

    @property
    def counters(self) -> GateCounters:
        with self._heard:
            return self._listener.counters

    @property
    def identity(self) -> Identity | None:
        """Name, serial number and firmware of the gate; None before it answered."""
        return self._listener.identity

    @property
    def pulses(self) -> CameraPulses | None:
        """How the gate pulses the cameras' trigger line; None for one that cannot delay, or not yet answered."""
        return self._listener.pulses

    @property
    def warnings(self) -> tuple[str, ...]:
        """Things that work but need attention, each with the remedy; never blocks."""
        now_ns = time.monotonic_ns()
        with self._heard:
            blocked_s, found = self._listener.blocked_s(now_ns), self._listener.troubles(now_ns)
        if blocked_s >= self._settings.blocked_s:
            found.append(told(DeviceFault.BEAM_CLOSED, closed_s=blocked_s))
        if self.identity is not None and is_outdated(self.identity):
            found.append(
                told(DeviceFault.GATE_FIRMWARE_OLD, version=self.identity.version, current=FIRMWARE_VERSION)
            )
        return tuple(problem.after(f"light gate {self._settings.port}: ") for problem in found)

    def resume(self, count: GateCount, n_known: int) -> None:
        """Go on from the count of an earlier process that was killed while the gate was armed."""
        host_ns = None
        with suppress(ValueError, TypeError):  # of a damaged store; the count alone decides then
            host_ns = None if count.at is None else time.monotonic_ns() - ns_since(count.at)
        with self._heard:
            self._listener.resume(count, host_ns)
            self._is_owed, self._n_owed, self._was_down = True, -n_known, True

    def open(self) -> None:
        """Open and lock the port and wait for the gate's first status; raises `GateUnavailableError`."""
        if self._thread.is_running and self._thread.failure is None:
            return
        self.close()
        port = self._port = self._connect()
        with self._heard:
            self._listener.reopen()
            self._is_answered = False
        self._thread.start(lambda: self._turn(port))
        deadline_s, n_damaged = time.monotonic() + self._settings.answer_timeout_s, self.counters.garbage
        try:
            while not self._answers(self._protocol.identify, lambda: self._listener.n_statuses, ASK_AGAIN_S):
                if self._thread.failure is not None:
                    raise self._thread.error(self._thread.failure)
                if time.monotonic() > deadline_s:
                    raise self._thread.error(self._unidentified(n_damaged))
            self._set_pulses()
        except BaseException:
            self.close()
            raise
        with self._heard:
            self._heard_ns, self._is_answered = time.monotonic_ns(), True

    def arm(self, sink: EventSink) -> None:
        """Deliver to `sink` from now on; first the stones that were counted since an armed gate was lost."""
        with self._heard:
            self._thread.arm(sink)
            if self._n_owed > 0:
                self._thread.deliver(
                    TriggersLost(
                        received_ns=time.monotonic_ns(),
                        count=self._n_owed,
                        reason="counted by the gate while it was lost",
                        while_down=self._was_down,
                    )
                )
            self._is_owed, self._n_owed, self._was_down = True, 0, False

    def test_pulse(self) -> None:
        """Let the gate trigger the cameras, and wait until it has; raises `GateUnavailableError`."""
        if not self._thread.is_armed:
            raise self._thread.error("is not armed")
        if not self._answers(
            self._protocol.test_pulse, lambda: self._listener.counters.test_pulses, TEST_PULSE_S
        ):
            raise self._thread.error(
                f"does not answer the command for a test pulse within {TEST_PULSE_S:g} s"
            )

    def disarm(self) -> None:
        with self._heard:
            if self._thread.is_armed and self._thread.failure is None:
                self._is_owed = False
            self._thread.disarm()

    def close(self) -> None:
        self.disarm()
        self._thread.stop()
        if self._port is not None:
            with suppress(OSError):  # it may be gone
                self._port.close()
            self._port = None

    def _connect(self) -> serial.Serial:
        try:
            port = serial.Serial(
                self._settings.port,
                self._settings.baud,
                timeout=READ_S,
                write_timeout=WRITE_S,
                exclusive=True,
            )
        except (OSError, ValueError, termios.error) as err:  # SerialException is an OSError
            raise self._thread.error(port_problem(err, self._settings.port)) from err
        keep_port(port.fileno())
        return port

    def _unidentified(self, n_damaged: int) -> Told:
        """Return the reason why the gate did not answer; `n_damaged` damaged lines were counted before."""
        waited_s = self._settings.answer_timeout_s
        with self._heard:
            return self._listener.not_understood(waited_s) or told(
                DeviceFault.GATE_UNIDENTIFIED,
                waited_s=waited_s,
                damaged=self._listener.counters.garbage - n_damaged,
            )

    def _set_pulses(self) -> None:
        """Set delay and width of the pulses unless they are in effect; raises `GateUnavailableError`."""
        if self._pulses_differ(DeviceFault.GATE_DELAY_REFUSED) is None and (
            self.pulses or not self._delay_us
        ):
            return  # a gate that says nothing makes no delay
        make = self._protocol.set_pulses
        if make is None or not any(
            self._answers(
                make(self._delay_us, self._settings.pulse_us), lambda: self._listener.n_pulses, ASK_AGAIN_S
            )
            for _ in range(SET_TRIES)
        ):
            raise self._thread.error(told(DeviceFault.GATE_CANNOT_DELAY, delay_us=self._delay_us))
        if problem := self._pulses_differ(DeviceFault.GATE_DELAY_REFUSED):
            raise self._thread.error(problem)

    def _pulses_differ(self, fault: DeviceFault) -> Told | None:
        """Return the fault when the gate said that it pulses the cameras otherwise than it should."""
        said, delay_us, pulse_us = self.pulses, self._delay_us, self._settings.pulse_us
        if said is None or (said.delay_us, said.pulse_us) == (delay_us, pulse_us):
            return None
        return told(
            fault, delay_us=delay_us, pulse_us=pulse_us, set_us=said.delay_us, set_pulse_us=said.pulse_us
        )

    def _answers(self, command: bytes, count: Callable[[], int], timeout_s: float) -> bool:
        """Send a command; returns whether `count` increased within `timeout_s`."""
        if self._port is None:
            raise self._thread.error("is not open")
        with self._heard:
            before = count()
        try:
            self._port.write(command)
        except OSError as err:
            raise self._thread.error(f"cannot be sent a command: {err}") from err
        with self._heard:
            return self._heard.wait_for(lambda: count() > before, timeout_s)

    def _turn(self, port: serial.Serial) -> None:
        data = port.read(1)
        data += port.read(port.in_waiting)
        now_ns = time.monotonic_ns()
        with self._heard:
            n_lines, n_restarts = self._listener.counters.lines, self._listener.counters.restarts
            for event in self._listener.hear(data, now_ns):
                self._hand_over(event)
            if self._listener.counters.lines > n_lines:
                self._heard_ns = now_ns
            has_restarted = self._listener.counters.restarts > n_restarts
            self._heard.notify_all()
        if self._is_answered and has_restarted:
            port.write(self._protocol.identify)  # to hear which delay it has now
        if self._is_answered and (differing := self._pulses_differ(DeviceFault.GATE_DELAY_DIFFERS)):
            raise self._thread.error(differing)  # it is opened again, and set
        silence_s = self._settings.silence_s
        if self._is_answered and now_ns - self._heard_ns > silence_s * 1e9:
            noise = self._listener.not_understood(silence_s)
            raise self._thread.error(noise or told(DeviceFault.GATE_MUTE, silent_s=silence_s))

    def _hand_over(self, event: DeviceEvent) -> None:
        """Deliver an event, or count the stones it stands for until the gate is armed again."""
        if self._thread.is_armed:
            self._thread.deliver(event)
        elif self._is_owed:
            match event:
                case TriggersLost(count=count):
                    self._n_owed += count
                case Trigger(kind=BundleKind.PARTICLE):
                    self._n_owed += 1
