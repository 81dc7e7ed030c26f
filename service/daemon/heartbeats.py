"""Record which parts of the daemon make progress; time is an argument."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from service.base.messages import Code, message
from service.base.status import HealthCheck, health_check


class Watched(StrEnum):
    """A part of the daemon whose progress is watched."""

    ACQUISITION = "acquisition"
    PROCESSING = "processing"


@dataclass(slots=True)
class Heartbeats:
    """Time of the latest progress of each part; a part with nothing to do counts as making progress."""

    max_silence_s: Mapping[Watched, float]
    """Longest time without progress that a part may need."""
    last_beat_s: dict[Watched, float] = field(default_factory=dict)

    def beat(self, part: Watched, now_s: float) -> None:
        """Record that a part has made progress, or was found to have nothing to do."""
        self.last_beat_s[part] = now_s

    def late(self, now_s: float) -> list[Watched]:
        """Return the parts without progress for too long; before its first beat no part is late."""
        return [
            part
            for part, silence_s in self.max_silence_s.items()
            if now_s - self.last_beat_s.get(part, now_s) > silence_s
        ]

    def check(self, now_s: float) -> HealthCheck:
        """Check that no part is late."""
        late = self.late(now_s)
        problem = message(Code.NO_PROGRESS, parts=", ".join(late))
        return health_check(problem if late else None, fail=bool(late))
