"""Debounce the edges of a beam, so that one stone is one pulse. No clock; times are arguments.

A stone is announced at its first edge, at once. A beam that closes again within the debounce time after its last
edge was closed by the same stone; how long it was closed is known only when it has been open for that time. Two
stones in quick succession stay two: the gate does not decide what becomes of the second.
"""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Began:
    """A stone closed the beam."""

    at_ns: int


@dataclass(frozen=True, slots=True)
class Ended:
    """The beam is open again."""

    width_ns: int


@dataclass(frozen=True, slots=True)
class Bounced:
    """The beam was closed once more by the same stone."""

    at_ns: int


NEVER_NS = -(1 << 62)

Pulse = Began | Ended | Bounced


class EdgeFilter:
    """Turns edges into pulses; needs every edge in order, and `settle` when `settles_at_ns` is due.

    The beam is open at the beginning.
    """

    def __init__(self, debounce_ns: int) -> None:
        if debounce_ns < 0:
            raise ValueError(f"debounce_ns must not be negative, not {debounce_ns}")
        self._debounce_ns = debounce_ns
        self.reset()

    def reset(self) -> None:
        """Forget the pulse that is going on."""
        self._state: Literal["idle", "closed", "opened"] = "idle"
        self._began_ns = self._last_ns = NEVER_NS  # first and last edge of the pulse, or of the one before

    @property
    def settles_at_ns(self) -> int | None:
        """When the last pulse is certain to have ended; None while no end is pending."""
        return self._last_ns + self._debounce_ns if self._state == "opened" else None

    def settle(self, now_ns: int) -> list[Pulse]:
        """Return the end of the pulse once it is certain."""
        if self._state != "opened" or now_ns - self._last_ns < self._debounce_ns:
            return []
        self._state = "idle"
        return [Ended(self._last_ns - self._began_ns)]

    def edge(self, *, is_closed: bool, at_ns: int) -> list[Pulse]:
        """Take an edge; an opening without a closing before it is ignored."""
        pulses = self.settle(at_ns)
        if is_closed:
            pulses.append(self._close(at_ns))
        elif self._state != "idle":
            self._state, self._last_ns = "opened", at_ns
        return pulses

    def _close(self, at_ns: int) -> Pulse:
        is_bounce = at_ns - self._last_ns < self._debounce_ns
        self._last_ns = at_ns
        if not (
            is_bounce and self._state == "idle"
        ):  # a bounce after the settled end does not count for the width
            self._state = "closed"
        if is_bounce:
            return Bounced(at_ns)
        self._began_ns = at_ns  # also when the opening before it was missed; that width stays unknown
        return Began(at_ns)
