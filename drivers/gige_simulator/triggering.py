"""Decide which edges expose, and when: selectors, sources, activation, debouncer, delay, over-triggering.

No clock and no thread: every call is given its time, in `time.monotonic_ns`.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.gige_simulator.registers import Registers

LINE_TIME_NS = 8_000
"""Time to read out one line of the sensor: 8.2 ms for 1024 lines."""

_FRAME, _BURST = 0, 1
_ACTIVATIONS = {True: "RisingEdge", False: "FallingEdge"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A planned exposure."""

    trigger_ns: int  # time of the edge that caused it; of the start itself when free running
    exposed_ns: int
    exposure_us: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Settings:
    """The registers that an edge depends on, read once per change: edges must be processed quickly."""

    version: int
    modes: tuple[bool, bool]
    sources: tuple[str, str]
    activations: tuple[str, str]
    delays_ns: tuple[int, int]
    debounce_ns: Mapping[str, int]
    exposure_us: float
    readout_ns: int


class TriggerInput:
    """The state of the trigger inputs; not thread-safe."""

    def __init__(self, registers: Registers) -> None:
        self._registers = registers
        self._settings = _read(registers)
        self._last_edge_ns: dict[str, int] = {}
        self._last_end_ns: int | None = None
        self._is_burst_started = False

    def reset(self) -> None:
        """Forget the last exposure, as at the start of an acquisition."""
        self._last_end_ns = None
        self._is_burst_started = False

    def is_triggered(self) -> bool:
        """Whether any trigger is on; otherwise the camera runs freely."""
        return any(self._current().modes)

    def banks(self, source: str, *, rising: bool | None = None) -> list[int]:
        """Return the triggers that are on and listen to a source; `rising` is None for a source without edges."""
        settings = self._current()
        return [
            bank
            for bank in (_FRAME, _BURST)
            if settings.modes[bank]
            and settings.sources[bank] == source
            and (rising is None or settings.activations[bank] in (_ACTIVATIONS[rising], "AnyEdge"))
        ]

    def bounces(self, line: str, at_ns: int) -> bool:
        """True when the debouncer of `line` drops this edge."""
        last_ns = self._last_edge_ns.get(line)
        self._last_edge_ns[line] = at_ns
        return last_ns is not None and at_ns - last_ns < self._current().debounce_ns[line]

    def starts_burst(self, banks: list[int]) -> bool:
        """True when these triggers only enable the next frame trigger: with both on, a burst is one frame."""
        if not all(self._current().modes) or _BURST not in banks:
            return False
        self._is_burst_started = True
        return _FRAME not in banks

    def accept(self, banks: list[int], at_ns: int) -> Plan | None:
        """Return the exposure that these triggers cause at `at_ns`; None when the camera is not ready for one."""
        settings = self._current()
        if all(settings.modes) and not self._is_burst_started:
            return None
        plan = self.plan(at_ns, at_ns + settings.delays_ns[_FRAME if _FRAME in banks else _BURST])
        if plan is not None:
            self._is_burst_started = False
        return plan

    def plan(self, trigger_ns: int, exposed_ns: int) -> Plan | None:
        """Plan an exposure; None while the last one is due or exposing, or its readout would be disturbed."""
        settings = self._current()
        end_ns = exposed_ns + round(settings.exposure_us * 1000)
        last_end_ns = self._last_end_ns
        if last_end_ns is not None and (
            trigger_ns < last_end_ns or end_ns < last_end_ns + settings.readout_ns
        ):
            return None
        self._last_end_ns = end_ns
        return Plan(trigger_ns=trigger_ns, exposed_ns=exposed_ns, exposure_us=settings.exposure_us)

    def _current(self) -> _Settings:
        if self._settings.version != self._registers.version:
            self._settings = _read(self._registers)
        return self._settings


def _read(registers: Registers) -> _Settings:
    lines = registers.features["LineSelector"].entries
    return _Settings(
        version=registers.version,
        modes=(registers.choice("TriggerMode", 0) == "On", registers.choice("TriggerMode", 1) == "On"),
        sources=(registers.choice("TriggerSource", 0), registers.choice("TriggerSource", 1)),
        activations=(registers.choice("TriggerActivation", 0), registers.choice("TriggerActivation", 1)),
        delays_ns=(
            round(registers.quantity("TriggerDelay", 0) * 1000),
            round(registers.quantity("TriggerDelay", 1) * 1000),
        ),
        debounce_ns={
            line: round(registers.quantity("LineDebouncerTime", bank) * 1000) for line, bank in lines.items()
        },
        exposure_us=registers.quantity("ExposureTime"),
        readout_ns=registers.number("Height") * LINE_TIME_NS,
    )
