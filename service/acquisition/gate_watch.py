"""Watch for late and missing announcements of the light gate, by cameras and its own counter. Time is an argument.

Each trouble is named, with the remedy, for a minute after it was seen last.
"""

from collections import deque
from statistics import median

from drivers.interfaces import TriggersLost
from pipeline.frames import FrameBundle
from service.base.messages import Code, CodedText, message
from service.bundling.window import TRANSFER_MS, BundlingParameters

RECENT_S = 60.0
SILENT_STONES = 3
"""Stones in a row, seen by the cameras and not announced, from which the gate is taken to be silent."""
EARLY_STONES = 5
"""Latest stones over which it is judged whether frames come too early."""


class _Recent(deque[tuple[float, int]]):
    """Stones of one kind of trouble within the last minute: when, and how many; the reason told last."""

    why = ""

    def until(self, now_s: float) -> int:
        """Return their number, and forget those before."""
        while self and now_s - self[0][0] > RECENT_S:
            self.popleft()
        return sum(n_stones for _, n_stones in self)


class GateWatch:
    """Judges a gate that works by its own account; `warnings` can be read at any time."""

    def __init__(self, bundling: BundlingParameters) -> None:
        self._bundling = bundling
        self._unannounced, self._late = _Recent(), _Recent()
        self._counted, self._missed = _Recent(), _Recent()  # by the gate; by this machine
        self._n_silent = 0  # stones in a row that were not announced
        self._early_ms: deque[float] = deque(maxlen=EARLY_STONES)

    def note_bundle(self, bundle: FrameBundle, now_s: float) -> None:
        """Note a bundle of any trigger; one without frames says nothing of the gate, unless it announced it."""
        trigger = bundle.trigger
        if not trigger.is_announced:
            if bundle.frames:
                self._n_silent += 1
                self._unannounced.append((now_s, 1))
            return
        self._n_silent = 0
        if bundle.frames:
            delay_ns = median(frame.received_ns for frame in bundle.frames.values()) - trigger.received_ns
            self._early_ms.append(self._bundling.expected_delay_ms - delay_ns / 1e6)

    def note_late(self, now_s: float) -> None:
        """Note an announcement that came when its stone had become an orphan."""
        self._n_silent = 0
        self._late.append((now_s, 1))

    def note_gap(self, gap: TriggersLost, now_s: float) -> None:
        """Note a gap in the gate's own counter, or in what this machine read from its line."""
        gaps = self._missed if gap.by_host else self._counted
        gaps.append((now_s, gap.count))
        gaps.why = gap.reason

    def warnings(self, now_s: float) -> tuple[CodedText, ...]:
        """Return the present troubles of the gate, each with the remedy."""
        n_late = self._late.until(now_s)
        n_unannounced = self._unannounced.until(now_s) - n_late
        found = []
        if n_unannounced >= 1 and self._n_silent >= SILENT_STONES:
            found.append(message(Code.GATE_SILENT, stones=self._n_silent))
        elif n_unannounced >= 1:
            found.append(message(Code.GATE_UNANNOUNCED, stones=n_unannounced))
        if n_late:
            found.append(message(Code.GATE_LATE, stones=n_late))
        for code, gaps in ((Code.GATE_COUNTED, self._counted), (Code.GATE_EDGES_MISSED, self._missed)):
            if n_stones := gaps.until(now_s):
                found.append(message(code, stones=n_stones, reported=gaps.why))
        if len(self._early_ms) == EARLY_STONES and median(self._early_ms) > max(
            self._bundling.window_ms / 2, TRANSFER_MS
        ):
            found.append(message(Code.GATE_EARLY, early_ms=median(self._early_ms)))
        return tuple(found)
