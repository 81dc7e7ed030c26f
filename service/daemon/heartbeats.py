"""Which parts of the daemon make progress; time enters as an argument."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class Part(StrEnum):
    """A part of the daemon whose progress is watched."""

    ACQUISITION = "acquisition"
    PROCESSING = "processing"


@dataclass(slots=True)
class Heartbeats:
    """When each part last made progress.

    A part that has nothing to do beats, too, when that was verified.
    """

    limits_s: Mapping[Part, float]
    beats_s: dict[Part, float] = field(default_factory=dict)

    def beat(self, part: Part, now_s: float) -> None:
        """Note that a part has made progress."""
        self.beats_s[part] = now_s

    def late(self, now_s: float) -> list[Part]:
        """Return the parts without progress for longer than their limit; before its first beat none is late."""
        return [
            part for part, limit_s in self.limits_s.items() if now_s - self.beats_s.get(part, now_s) > limit_s
        ]
