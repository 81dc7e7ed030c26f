"""Check frames that were matched by time of arrival against their camera's own clock and counter.

The clock can refuse a frame that arrived a whole period late, exactly when the next was due. Only clock and counter
together, compared with an earlier frame, prove which trigger a frame was exposed for: a clock may be set by a whole
period, and a counter skips what the camera missed. Alone, the counter reveals what was lost and where.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from operator import attrgetter
from typing import NamedTuple

CLOCK_DRIFT = 2e-4
"""Relative drift allowed between two unsynchronised crystals: four times what their makers specify."""
LATEST_FRAME_NS = 10_000_000_000
"""Largest delay of a frame; a larger disagreement means that the camera's clock was set anew."""
MANY_FRAMES = 8
"""Frames in a row that show that a clock was set, when the counter does not."""
LARGEST_ID_STEP = 0x7FFF
"""Largest step of the frame counter that counts as loss; a larger one is a restart of the counter."""


class MatchedFrame(NamedTuple):
    """A frame paired with a trigger that it may have been exposed for."""

    device_ns: int
    frame_id: int
    trigger_ns: int  # when the trigger's announcement arrived
    ordinal: int  # number of the trigger, among those that expose
    apart_ns: int = LATEST_FRAME_NS  # from the trigger to the nearest other one


@dataclass(slots=True)
class ExposureCheck:
    """Compares the time between two exposures on one camera's own clock with the time between their triggers."""

    tolerance_ns: int
    _reference: MatchedFrame | None = None
    _refused: list[MatchedFrame] = field(default_factory=list)
    """The latest frames refused in a row that agree with one another."""

    def belongs(self, exposure: MatchedFrame, *, is_late: bool = False) -> bool:
        """True when the frame can have been exposed for its trigger; if so it is the next reference.

        `is_late`: it came after the window of its trigger, which then is a guess; its camera's counter must not
        contradict, unless the frames before it agree.

        Without a reference to compare with, only a frame of the very first trigger is accepted: any other may
        be a predecessor's that came late. It becomes the reference as soon as a second frame agrees with it.
        """
        if exposure.device_ns == 0:  # a camera without a clock
            return True
        reference = self._reference
        fits = exposure.ordinal == 0 if reference is None else self.fits(exposure)
        if is_late and reference is not None:
            # taken for a later trigger's, it would be behind by its camera's counter
            n_exposed = id_step(reference.frame_id, exposure.frame_id)
            fits = fits and n_exposed is not None and n_exposed >= exposure.ordinal - reference.ordinal
        agrees = bool(self._refused) and self._misfit_ns(self._refused[-1], exposure) == 0
        if fits or (agrees and self._was_set_anew([*self._refused, exposure], is_late=is_late)):
            self._reference, self._refused = exposure, []
            return True
        self._refused = [*self._refused[1 - MANY_FRAMES :], exposure] if agrees else [exposure]
        return False

    def _was_set_anew(self, exposures: Sequence[MatchedFrame], *, is_late: bool) -> bool:
        """True when refused frames that agree with one another show that the camera's clock or counter was set.

        Otherwise they are late by a trigger or more. No frame is late by as much as `LATEST_FRAME_NS`; of late ones the
        counter is behind; and many stones at irregular times cannot all be followed by their predecessors' frames.
        """
        reference, last = self._reference, exposures[-1]
        if is_late and reference is None and len(exposures) < MANY_FRAMES:
            return False
        if reference is None or self._misfit_ns(reference, last) > LATEST_FRAME_NS:
            return True
        if not all(_is_counted(*pair) for pair in pairwise(exposures)):
            return False
        if self._misfit_ns(reference, last) == 0:
            return True  # its clock was right: the counter had skipped what it missed
        spacings_ns = [later.trigger_ns - earlier.trigger_ns for earlier, later in pairwise(exposures)]
        is_irregular = max(spacings_ns) - min(spacings_ns) > 2 * self.tolerance_ns
        return _is_counted(reference, last) or (len(exposures) >= MANY_FRAMES and is_irregular)

    def proves(self, exposure: MatchedFrame) -> bool:
        """True when clock and counter, compared with the reference, both match the frame to its trigger."""
        reference = self._reference
        return (
            reference is not None
            and self._misfit_ns(reference, exposure) == 0
            and self._is_sharp(reference, exposure)
            and _is_counted(*sorted((reference, exposure), key=attrgetter("ordinal")))
        )

    def trigger_ns(self, device_ns: int) -> tuple[int, float] | None:
        """Return when the trigger of an exposure was by the camera's clock, and how far that may have drifted.

        None without clock or reference.
        """
        if device_ns == 0 or self._reference is None:
            return None
        since_ns = device_ns - self._reference.device_ns
        return self._reference.trigger_ns + since_ns, CLOCK_DRIFT * abs(since_ns)

    def fits(self, exposure: MatchedFrame) -> bool:
        """True when the clocks agree; where they may agree with another trigger as well, the counter must too."""
        reference = self._reference
        return (
            reference is not None
            and self._misfit_ns(reference, exposure) == 0
            and (self._is_sharp(reference, exposure) or _is_counted(reference, exposure))
        )

    def _is_sharp(self, earlier: MatchedFrame, later: MatchedFrame) -> bool:
        """True when clocks that drifted apart since the earlier exposure still tell the trigger from the nearest."""
        return later.apart_ns > self.tolerance_ns + 2 * self._drift_ns(earlier, later)

    def _drift_ns(self, earlier: MatchedFrame, later: MatchedFrame) -> float:
        """Largest drift of the two clocks from one exposure to the other."""
        return CLOCK_DRIFT * abs(later.trigger_ns - earlier.trigger_ns)

    def _misfit_ns(self, earlier: MatchedFrame, later: MatchedFrame) -> float:
        """Difference of the two durations beyond the limits of jitter and drift; 0 when they agree."""
        by_camera_ns = later.device_ns - earlier.device_ns
        by_triggers_ns = later.trigger_ns - earlier.trigger_ns
        allowed_ns = self.tolerance_ns + self._drift_ns(earlier, later)
        return max(0.0, abs(by_camera_ns - by_triggers_ns) - allowed_ns)


def _is_counted(earlier: MatchedFrame, later: MatchedFrame) -> bool:
    """True when the camera counted as many exposures from one to the other as there were triggers."""
    n_triggers = later.ordinal - earlier.ordinal
    if n_triggers == 0:
        return earlier.frame_id == later.frame_id
    return id_step(earlier.frame_id, later.frame_id) == n_triggers


def id_step(earlier: int, later: int) -> int | None:
    """Return the number of exposures from one frame id to a later one, None when the counter was restarted.

    GigE Vision block ids have 16 or 64 bits and wrap to 1: 0 is never used.
    """
    step = later - earlier
    if step < 0:
        step %= 0xFFFF if earlier <= 0xFFFF else 0xFFFF_FFFF_FFFF_FFFF
    return step if 0 < step <= LARGEST_ID_STEP else None
