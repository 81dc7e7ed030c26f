"""Turn the bytes of a serial gate into events, without port or thread; every loss is an event."""

import logging
from collections import deque
from dataclasses import astuple, replace

from drivers.errors import DeviceFault, Told, told
from drivers.gates.edge_counter import CountedStep, EdgeCounter
from drivers.gates.edge_filter import Began, Bounced, EdgeFilter, Ended, Pulse
from drivers.gates.gate_clock import GateClock
from drivers.gates.gate_records import (
    SEQUENCES,
    CameraPulses,
    Edge,
    GateProtocol,
    Identity,
    Record,
    Status,
    TestPulse,
    UnknownRecordError,
    Width,
)
from drivers.gates.gate_thread import trigger_at
from drivers.gates.reception import GateCounters, Reception
from drivers.interfaces import DeviceEvent, PulseEnded, TriggersIgnored, TriggersLost
from pipeline.frames import BundleKind, GateCount, Trigger

log = logging.getLogger(__name__)

BITS_A_BYTE = 10
"""8N1: with start and stop bit."""
LATE_NS = 200_000_000
"""Delay of a line above which it is counted as late; from 0.3 s on its stone's frames wait for it no longer."""
RECENT_NS = 60_000_000_000
"""Time for which late lines and a restart are reported."""


class GateListener:
    """Decodes what was read from the port, in order; keeps its state of the gate when the port is opened again.

    After `reopen` all lines are ignored until the gate has identified itself: it may be another one.
    """

    def __init__(self, protocol: GateProtocol, *, baud: int, debounce_ns: int) -> None:
        self._decode = protocol.decode
        self._byte_ns = BITS_A_BYTE * 1_000_000_000 // baud
        self._lines = protocol.splitter()
        self._counter = EdgeCounter()
        self._clock = GateClock()
        self._filter = EdgeFilter(debounce_ns)
        self._sequence = 0  # of the pulse in the filter
        self._edge: Edge | None = None
        self._ignored: int | None = None
        self._unmade: int | None = None
        self._unmade_pulses: deque[tuple[int, int]] = deque(maxlen=256)  # time and number
        self._blocked_since_ns: int | None = None
        self._late_lines: deque[tuple[int, int]] = deque(maxlen=256)  # time and delay
        self._unknown_lines: deque[tuple[int, str]] = deque(maxlen=256)  # time and text
        self._restarted_ns: int | None = None
        self._is_clock_short = False
        self._counters = GateCounters()
        self._reception = Reception()
        self._is_recognised = True
        self.identity: Identity | None = None
        self.pulses: CameraPulses | None = None
        """How it pulses the cameras' trigger line; None until it said so."""
        self.n_statuses = self.n_pulses = 0  # records received

    @property
    def counters(self) -> GateCounters:
        """A copy."""
        return replace(self._counters, garbage=self._counters.garbage + self._lines.n_discarded)

    def resume(self, count: GateCount, host_ns: int | None) -> None:
        """Go on from the count of an earlier process, at `host_ns`, if the gate turns out to be the same."""
        name, serial, version = count.gate.split(",")
        self.identity = Identity(name=name, serial=serial, version=version)
        self._counter.resume(count.sequence, count.device_us, host_ns)

    def reopen(self) -> None:
        """Forget what does not outlive a closed port: half a line, half a pulse, the offset of the clocks."""
        self._lines.discard()
        self._clock.restart()
        self._filter.reset()
        self._blocked_since_ns = None
        self._is_recognised = False
        self.pulses = None
        self._reception.begin(self.counters.garbage)

    def not_understood(self, waited_s: float) -> Told | None:
        """Return the reason why what was received since the last valid line is none; None if it was nothing."""
        return self._reception.problem(waited_s, self.counters.garbage)

    def blocked_s(self, now_ns: int) -> float:
        """Return for how long the beam has been closed, in s, by the gate's statuses."""
        return 0.0 if self._blocked_since_ns is None else (now_ns - self._blocked_since_ns) / 1e9

    def troubles(self, now_ns: int) -> list[Told]:
        """Return the problems of the last minute, each with the remedy."""
        found = []
        late_ns = [late_ns for at_ns, late_ns in self._late_lines if now_ns - at_ns < RECENT_NS]
        if late_ns:
            found.append(
                told(
                    DeviceFault.GATE_LINES_LATE,
                    lines=len(late_ns),
                    late_ms=max(late_ns) / 1e6,
                    since_start=self._counters.late,
                )
            )
        if self._restarted_ns is not None and now_ns - self._restarted_ns < RECENT_NS:
            found.append(told(DeviceFault.GATE_RESTARTED))
        if self._is_clock_short:
            found.append(told(DeviceFault.GATE_CLOCK_SHORT))
        unmade = sum(number for at_ns, number in self._unmade_pulses if now_ns - at_ns < RECENT_NS)
        if unmade and self.pulses is not None:
            found.append(told(DeviceFault.GATE_PULSES_UNMADE, pulses=unmade, places=self.pulses.places))
        unknown = [text for at_ns, text in self._unknown_lines if now_ns - at_ns < RECENT_NS]
        if unknown:
            found.append(told(DeviceFault.GATE_LINES_UNKNOWN, lines=len(unknown), reported=unknown[-1]))
        return found

    def hear(self, data: bytes, read_ns: int) -> list[DeviceEvent]:
        """Return the events of what was read at `read_ns`; damaged data is counted as garbage and never raises."""
        events: list[DeviceEvent] = []
        self._reception.note(data)
        for line in self._lines.feed(data):
            try:
                record = self._decode(line.text)
            except UnknownRecordError as err:
                self._counters.unknown += 1
                self._unknown_lines.append((read_ns, line.text.decode("ascii", "replace").strip()))
                log.debug("light gate: left out: %s", err)
            except ValueError as err:
                self._counters.garbage += 1
                log.debug("light gate: garbage: %s", err)
                continue
            else:
                # the first byte of the line was sent no later than the bytes after it take
                events += self._take(record, read_ns - line.age_bytes * self._byte_ns)
            self._counters.lines += 1
            self._reception.begin(self.counters.garbage)
        return events + self.settle(read_ns)

    def settle(self, now_ns: int) -> list[DeviceEvent]:
        """Return the end of the last pulse once it is certain."""
        device_ns = self._clock.device_ns(now_ns)
        pulses = [] if device_ns is None else self._filter.settle(device_ns)
        return [self._event(pulse, now_ns, self._sequence) for pulse in pulses]

    def _take(self, record: Record, latest_ns: int) -> list[DeviceEvent]:
        if not self._is_recognised and not isinstance(record, Identity):
            return []
        match record:
            case Edge() | TestPulse():
                return self._take_edge(record, latest_ns)
            case Width(sequence=sequence, width_us=width_us):
                if self._edge is None or self._edge.sequence != sequence:
                    return []  # the line that announced its edge was lost
                opened_ns = (self._edge.device_us + width_us) * 1000
                return self._filtered(is_closed=False, device_ns=opened_ns, received_ns=latest_ns)
            case Status():
                return self._take_status(record, latest_ns)
            case Identity():
                if self.identity not in (None, record):
                    log.warning("light gate was replaced: now %s, before %s", record, self.identity)
                    self._counter.forget()
                    self._is_clock_short = False
                    self._begin_anew(counted=None)
                self.identity, self._is_recognised = record, True
                return []
            case CameraPulses():
                if self._unmade is not None and (number := (record.unmade - self._unmade) % SEQUENCES):
                    self._counters.unmade += number
                    self._unmade_pulses.append((latest_ns, number))
                self.pulses, self._unmade = record, record.unmade
                self.n_pulses += 1
                return []

    def _take_edge(self, record: Edge | TestPulse, latest_ns: int) -> list[DeviceEvent]:
        step = self._counter.edge(record.sequence, record.device_us, latest_ns)
        if step.is_repeated:
            self._counters.repeated += 1
            return [TriggersIgnored(received_ns=latest_ns, count=1, reason="repeated")]
        events = self._account(step, latest_ns)
        record = replace(record, device_us=step.device_us)
        device_ns = record.device_us * 1000
        received_ns = self._dated(device_ns, latest_ns)
        if isinstance(record, TestPulse):
            self._counters.test_pulses += 1
            kind = BundleKind.BACKGROUND
            trigger = trigger_at(received_ns, step.sequence, device_ns=device_ns, kind=kind)
            return [*events, self._counted(trigger, record)]
        self._edge = record
        self._counters.edges += 1
        return events + self._filtered(
            is_closed=True, device_ns=device_ns, received_ns=received_ns, sequence=step.sequence
        )

    def _take_status(self, status: Status, latest_ns: int) -> list[DeviceEvent]:
        step = self._counter.status(status.last_sequence, status.device_us, latest_ns)
        events = self._account(step, latest_ns)
        self._dated(step.device_us * 1000, latest_ns)
        if self._ignored is not None and (count := (status.ignored - self._ignored) % SEQUENCES):
            self._counters.ignored += count
            events.append(TriggersIgnored(received_ns=latest_ns, count=count, reason="bounce"))
        self._ignored = status.ignored
        if not status.is_blocked:
            self._blocked_since_ns = None
        elif self._blocked_since_ns is None:
            self._blocked_since_ns = latest_ns
        self.n_statuses += 1
        return events

    def _dated(self, device_ns: int, latest_ns: int) -> int:
        """Return the host's time of a line, and note how late it came."""
        host_ns = self._clock.host_ns(device_ns, latest_ns)
        if latest_ns - host_ns > LATE_NS:
            self._counters.late += 1
            self._late_lines.append((latest_ns, latest_ns - host_ns))
        return host_ns

    def _begin_anew(self, *, counted: int | None) -> None:
        """Forget the state of another gate, or of this one before a restart, since when it `counted`."""
        self._clock.restart()
        self._filter.reset()
        self._edge = None
        self._ignored = self._unmade = counted

    def _account(self, step: CountedStep, latest_ns: int) -> list[DeviceEvent]:
        if step.has_restarted:
            self._counters.restarts += 1
            self._restarted_ns = latest_ns
            self._begin_anew(counted=None if step.missed is None else 0)
            missed = "an unknown number" if step.missed is None else step.missed
            log.warning("light gate was restarted, stones missed: %s; check its power supply", missed)
        if step.has_stepped_back:
            self._clock.restart()
            self._filter.reset()
            log.warning("light gate: its clock went back, but it counts on; look at its firmware")
        if step.has_wrapped:
            self._counters.wraps += 1
            self._is_clock_short = True
            log.warning("light gate: its clock of 32 bits wrapped to 0; it is counted on")
        if not step.missed:
            return []
        self._counters.missed += step.missed
        reason = "the gate restarted" if step.has_restarted else "counted by the gate, not announced"
        return [TriggersLost(received_ns=latest_ns, count=step.missed, reason=reason)]

    def _filtered(
        self, *, is_closed: bool, device_ns: int, received_ns: int, sequence: int = 0
    ) -> list[DeviceEvent]:
        pulses = self._filter.edge(is_closed=is_closed, at_ns=device_ns)
        return [self._event(pulse, received_ns, sequence) for pulse in pulses]

    def _counted(self, trigger: Trigger, record: Edge | TestPulse | None) -> Trigger:
        """Return the trigger with the gate's count at its record."""
        if record is None or self.identity is None:
            return trigger
        gate = ",".join(astuple(self.identity))
        sent_us = self._counter.sent_us(record.device_us)
        count = GateCount(gate=gate, sequence=record.sequence, device_us=sent_us)
        return replace(trigger, gate_count=count)

    def _event(self, pulse: Pulse, received_ns: int, sequence: int) -> DeviceEvent:
        match pulse:
            case Began(at_ns=device_ns):
                self._sequence = sequence
                return self._counted(trigger_at(received_ns, sequence, device_ns=device_ns), self._edge)
            case Ended(width_ns=width_ns):
                return PulseEnded(sequence=self._sequence, received_ns=received_ns, width_ns=width_ns)
            case Bounced():
                self._counters.bounces += 1
                return TriggersIgnored(received_ns=received_ns, count=1, reason="bounce")
