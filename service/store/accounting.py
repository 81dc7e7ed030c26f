"""The balance of triggers: `triggers = measured + rejected + lost + in_progress`, each counted by itself."""

from collections.abc import Mapping
from dataclasses import dataclass

from pydantic import computed_field

from service.base.schema import ANSWER


@dataclass(frozen=True, slots=True, kw_only=True)
class Accounting:
    """Counts of the light gate's triggers by outcome; background exposures are counted separately."""

    __pydantic_config__ = ANSWER

    triggers: int
    """Stones and balls that the light gate reported."""
    measured: int
    """Triggers whose stone has a body and its measures."""
    rejected: int
    """Triggers whose views were looked at and found unfit."""
    lost: int
    """Triggers whose views were never looked at."""
    in_progress: int
    """Triggers without an outcome yet."""
    backgrounds: int
    """Exposures of the empty rig; not among the triggers."""
    by_reason: Mapping[str, int]
    """Rejected and lost triggers, by reason."""
    by_quality: Mapping[str, int]
    """Measured triggers, by quality."""

    @computed_field(description="True if the sum holds; false is a fault of the service")  # type: ignore[prop-decorator]  # pydantic asks for this order
    @property
    def is_balanced(self) -> bool:
        """True if every trigger is counted exactly once; `False` is a fault of the store."""
        return self.triggers == self.measured + self.rejected + self.lost + self.in_progress
