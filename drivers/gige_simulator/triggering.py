"""Which edges expose, and when: selectors, sources, activation, debouncer, delay, over-triggering.

No clock and no thread: every call says at which moment of `time.monotonic_ns` it happens.
"""

from dataclasses import dataclass

from drivers.gige_simulator.registers import Registers

LINE_TIME_NS = 8_000
"""Readout of one line of the sensor: 8.2 ms for 1024 lines."""

_FRAME, _BURST = 0, 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """An exposure to come."""

    trigger_ns: int  # the edge that caused it; the start itself when free running
    exposed_ns: int
    exposure_us: float


class TriggerInput:
    """State of the trigger inputs; not thread safe."""

    def __init__(self, registers: Registers) -> None:
        self._registers = registers
        self._last_edge_ns: dict[str, int] = {}
        self._last: Plan | None = None
        self._is_burst_started = False

    def reset(self) -> None:
        """Forget the last exposure: acquisition starts."""
        self._last = None
        self._is_burst_started = False

    def is_triggered(self) -> bool:
        """Whether any trigger is on; otherwise the camera runs freely."""
        return any(self._registers.choice("TriggerMode", bank) == "On" for bank in (_FRAME, _BURST))

    def banks(self, source: str, *, rising: bool | None = None) -> list[int]:
        """Return the triggers that are on and listen to this source; `rising` is None for what has no edges."""
        return [
            bank
            for bank in (_FRAME, _BURST)
            if self._registers.choice("TriggerMode", bank) == "On"
            and self._registers.choice("TriggerSource", bank) == source
            and self._is_active(bank, rising)
        ]

    def bounces(self, line: str, at_ns: int) -> bool:
        """Whether the debouncer of `line` swallows this edge."""
        bank = self._registers.features["LineSelector"].entries[line]
        debounce_ns = self._registers.quantity("LineDebouncerTime", bank) * 1000
        last_ns = self._last_edge_ns.get(line)
        self._last_edge_ns[line] = at_ns
        return last_ns is not None and at_ns - last_ns < debounce_ns

    def starts_burst(self, banks: list[int]) -> bool:
        """Whether these triggers only let the next frame trigger pass: with both on, one burst one frame."""
        if not self._are_both_on() or _BURST not in banks:
            return False
        self._is_burst_started = True
        return _FRAME not in banks

    def accept(self, banks: list[int], at_ns: int) -> Plan | None:
        """Return what these triggers, seen at `at_ns`, expose; nothing when the camera is not ready for one."""
        if self._are_both_on() and not self._is_burst_started:
            return None
        bank = _FRAME if _FRAME in banks else _BURST
        plan = self.plan(at_ns, at_ns + round(self._registers.quantity("TriggerDelay", bank) * 1000))
        if plan is not None:
            self._is_burst_started = False
        return plan

    def _are_both_on(self) -> bool:
        return all(self._registers.choice("TriggerMode", bank) == "On" for bank in (_FRAME, _BURST))

    def plan(self, trigger_ns: int, exposed_ns: int) -> Plan | None:
        """Plan an exposure; nothing while the last one is due or exposing, or its readout would be disturbed."""
        plan = Plan(
            trigger_ns=trigger_ns,
            exposed_ns=exposed_ns,
            exposure_us=self._registers.quantity("ExposureTime"),
        )
        if self._last is not None:
            last_end_ns = _end_ns(self._last)
            readout_ns = self._registers.number("Height") * LINE_TIME_NS
            if trigger_ns < last_end_ns or _end_ns(plan) < last_end_ns + readout_ns:
                return None
        self._last = plan
        return plan

    def _is_active(self, bank: int, rising: bool | None) -> bool:
        match self._registers.choice("TriggerActivation", bank):
            case "RisingEdge":
                return rising is not False
            case "FallingEdge":
                return rising is not True
            case _:
                return True


def _end_ns(plan: Plan) -> int:
    return plan.exposed_ns + round(plan.exposure_us * 1000)
