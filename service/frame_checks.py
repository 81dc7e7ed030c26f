"""What a camera's own clock and counter tell about frames that were matched by time.

The clock can refuse a frame that arrived a whole period late, exactly when the next was due, and, compared with
an earlier frame, tell which trigger it was exposed for. The counter never matches a frame to a trigger: it
reveals what was lost and where.
"""

from dataclasses import dataclass

CLOCK_DRIFT = 2e-4
"""Relative drift allowed between two unsynchronised crystals: four times what their makers allow."""
LATEST_FRAME_NS = 10_000_000_000
"""No frame is later than this; a larger disagreement means that the camera's clock was set anew."""
LARGEST_ID_STEP = 0x7FFF
"""A larger step of the counter is a restart, not a loss."""


@dataclass(slots=True)
class ExposureCheck:
    """Compares the time between two exposures on a camera's own clock with that between their triggers."""

    tolerance_ns: int
    _reference: tuple[int, int] | None = None  # device_ns of a frame, received_ns of its trigger
    _candidate: tuple[int, int] | None = None

    def belongs(self, device_ns: int, trigger_ns: int, *, is_first_trigger: bool) -> bool:
        """Whether a frame can have been exposed for this trigger.

        Without a trusted frame to compare with, only one of the very first trigger is believed: any
        other may be a predecessor's that came late. It is trusted as soon as a second one agrees.
        After the clock was set anew it takes two agreeing frames as well.
        """
        if device_ns == 0:  # a camera without a clock
            return True
        here = (device_ns, trigger_ns)
        misfit_ns = None if self._reference is None else self._misfit_ns(self._reference, here)
        fits = is_first_trigger if misfit_ns is None else misfit_ns == 0
        if not fits and self._candidate is not None:
            fits = self._misfit_ns(self._candidate, here) == 0
        if fits:
            self._reference, self._candidate = here, None
        elif misfit_ns is None or misfit_ns > LATEST_FRAME_NS:
            self._candidate = here
        return fits

    def distance_ns(self, device_ns: int, trigger_ns: int) -> int | None:
        """How far from a trigger's exposure this frame's was; None when it was not that one, or nobody can tell."""
        if device_ns == 0 or self._reference is None:
            return None
        here = (device_ns, trigger_ns)
        return (
            _disagreement_ns(self._reference, here) if self._misfit_ns(self._reference, here) == 0 else None
        )

    def contradicts(self, device_ns: int, trigger_ns: int) -> bool:
        """Whether a trusted frame proves that this one was not exposed for a trigger at that time."""
        if device_ns == 0 or self._reference is None:
            return False
        return 0 < self._misfit_ns(self._reference, (device_ns, trigger_ns)) <= LATEST_FRAME_NS

    def _misfit_ns(self, earlier: tuple[int, int], later: tuple[int, int]) -> float:
        """How far the two durations differ beyond what jitter and drift explain; 0 when they agree."""
        allowed_ns = self.tolerance_ns + CLOCK_DRIFT * abs(later[1] - earlier[1])
        return max(0.0, _disagreement_ns(earlier, later) - allowed_ns)


def _disagreement_ns(earlier: tuple[int, int], later: tuple[int, int]) -> int:
    """How far the time between two frames by their camera's clock is from that between their triggers."""
    return abs((later[0] - earlier[0]) - (later[1] - earlier[1]))


def id_step(earlier: int, later: int) -> int | None:
    """Exposures from one frame id to a later one, or nothing when the counter was restarted.

    GigE Vision block ids have 16 or 64 bits and wrap to 1: 0 is never used.
    """
    step = later - earlier
    if step < 0:
        step %= 0xFFFF if earlier <= 0xFFFF else 0xFFFF_FFFF_FFFF_FFFF
    return step if 0 < step <= LARGEST_ID_STEP else None
