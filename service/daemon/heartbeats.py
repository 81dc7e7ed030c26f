"""What should move is watched. Time enters as an argument."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(slots=True)
class Heartbeats:
    """When each part last made progress; a part that is late is named.

    A part that has nothing to do calls `beat` when it has verified just that.
    """

    limits_s: Mapping[str, float]
    beats_s: dict[str, float] = field(default_factory=dict)

    def beat(self, part: str, now_s: float) -> None:
        self.beats_s[part] = now_s

    def late(self, now_s: float) -> list[str]:
        """Name the parts without progress for longer than their limit; before its first beat none is late."""
        return [
            part for part, limit_s in self.limits_s.items() if now_s - self.beats_s.get(part, now_s) > limit_s
        ]
