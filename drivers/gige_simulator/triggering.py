"""Decide which edges expose, and when: selectors, sources, activation, debouncer, delay, over-triggering.

No clock and no thread: every call is given its time, in `time.monotonic_ns`.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.gige_simulator.registers import Registers

LINE_TIME_NS = 8_000
"""Time to read out one line of the sensor: 8.2 ms for 1024 lines."""

_FRAME_TRIGGER = "FrameStart"
_BURST_TRIGGERS = ("FrameBurstStart", "AcquisitionStart")
_ACTIVATIONS = {True: "RisingEdge", False: "FallingEdge"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A planned exposure."""

    trigger_ns: int  # time of the edge that caused it; of the start itself when free running
    exposed_ns: int
    exposure_us: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Settings:
    """The registers that an edge depends on, read once per change: edges must be processed quickly.

    Banks are the entries of the trigger selector.
    """

    version: int
    on: frozenset[int]  # banks of triggers that are on
    frame: int | None  # bank of the trigger of single frames, if there is one
    starts_only: bool  # all triggers that are on start frames or bursts; others are waited for without end
    sources: tuple[str, ...]
    activations: tuple[str, ...]
    delays_ns: tuple[int, ...]
    debounce_ns: Mapping[str, int]
    exposure_us: float
    readout_ns: int
    period_ns: int  # shortest time between two triggers
    n_burst: int
    is_timed: bool  # exposures are as long as the exposure time says


class TriggerInput:
    """The state of the trigger inputs; not thread-safe."""

    def __init__(self, registers: Registers) -> None:
        self._registers = registers
        self._settings = _read(registers)
        self._last_edge_ns: dict[str, int] = {}
        self._last_end_ns: int | None = None
        self._last_trigger_ns: int | None = None
        self._is_burst_started = False

    def reset(self) -> None:
        """Forget the last exposure, as at the start of an acquisition."""
        self._last_end_ns = self._last_trigger_ns = None
        self._is_burst_started = False

    def is_triggered(self) -> bool:
        """Whether any trigger is on; otherwise the camera runs freely."""
        return bool(self._current().on)

    @property
    def n_burst(self) -> int:
        """Frames per trigger, if no trigger of single frames is on."""
        settings = self._current()
        return 1 if settings.frame in settings.on or not settings.on else settings.n_burst

    def banks(self, source: str, *, rising: bool | None = None) -> list[int]:
        """Return the triggers that are on and listen to a source; `rising` is None for a source without edges."""
        settings = self._current()
        return [
            bank
            for bank in sorted(settings.on)
            if settings.sources[bank] == source
            and (rising is None or settings.activations[bank] in (_ACTIVATIONS[rising], "AnyEdge"))
        ]

    def bounces(self, line: str, at_ns: int) -> bool:
        """True when the debouncer of `line` drops this edge."""
        last_ns = self._last_edge_ns.get(line)
        self._last_edge_ns[line] = at_ns
        return last_ns is not None and at_ns - last_ns < self._current().debounce_ns[line]

    def starts_burst(self, banks: list[int]) -> bool:
        """True when these triggers only enable the next frame trigger: with both on, a burst is one frame."""
        settings = self._current()
        if settings.frame not in settings.on or len(settings.on) == 1 or banks == [settings.frame]:
            return False
        self._is_burst_started = True
        return settings.frame not in banks

    def accept(self, banks: list[int], at_ns: int) -> Plan | None:
        """Return the exposure that these triggers cause at `at_ns`; None when the camera is not ready for one."""
        settings = self._current()
        if settings.frame in settings.on and len(settings.on) > 1 and not self._is_burst_started:
            return None
        if not (settings.starts_only and settings.is_timed):
            return None
        if self._last_trigger_ns is not None and at_ns - self._last_trigger_ns < settings.period_ns:
            return None
        bank = next((bank for bank in banks if bank == settings.frame), banks[0])
        plan = self.plan(at_ns, at_ns + settings.delays_ns[bank])
        if plan is not None:
            self._is_burst_started = False
            self._last_trigger_ns = at_ns
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
    selectors = tuple(registers.features["TriggerSelector"].entries)
    banks = range(len(selectors))
    on = frozenset(bank for bank in banks if registers.choice("TriggerMode", bank) == "On")
    is_limited = registers.number("AcquisitionFrameRateEnable")
    return _Settings(
        version=registers.version,
        on=on,
        frame=next((bank for bank in banks if selectors[bank] == _FRAME_TRIGGER), None),
        starts_only=all(selectors[bank] in (_FRAME_TRIGGER, *_BURST_TRIGGERS) for bank in on),
        sources=tuple(registers.choice("TriggerSource", bank) for bank in banks),
        activations=tuple(registers.choice_or("TriggerActivation", "RisingEdge", bank) for bank in banks),
        delays_ns=tuple(round(registers.quantity_or("TriggerDelay", 0.0, bank) * 1000) for bank in banks),
        debounce_ns={
            line: round(registers.quantity_or("LineDebouncerTime", 0.0, bank) * 1000)
            for line, bank in lines.items()
        },
        exposure_us=registers.quantity("ExposureTime"),
        readout_ns=registers.number("Height") * LINE_TIME_NS,
        period_ns=round(1e9 / registers.quantity("AcquisitionFrameRate")) if is_limited else 0,
        n_burst=registers.number_or("AcquisitionBurstFrameCount", 1),
        is_timed=registers.choice_or("ExposureMode", "Timed") == "Timed",
    )
