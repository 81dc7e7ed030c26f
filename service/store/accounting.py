"""The balance of triggers: `triggers = measured + rejected + lost + in_progress`, each counted by itself."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Accounting:
    """Counts of the light gate's triggers by outcome; background exposures are counted separately."""

    triggers: int
    measured: int
    rejected: int
    lost: int
    in_progress: int  # recorded, without an outcome yet
    backgrounds: int
    by_reason: Mapping[str, int]  # of the rejected and the lost
    by_quality: Mapping[str, int]  # of the measured

    @property
    def is_balanced(self) -> bool:
        """Whether every trigger is counted exactly once; `False` is a fault of the store."""
        return self.triggers == self.measured + self.rejected + self.lost + self.in_progress
