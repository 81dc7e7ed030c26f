"""Most cameras fail at once: report the common cause instead of every camera."""

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.errors import LossCause


@dataclass(frozen=True, slots=True)
class DeviceLoss:
    """The reason and the kind of cause for which a device is lost."""

    reason: str
    cause: LossCause

    def is_like(self, other: "DeviceLoss | None") -> bool:
        """Return whether both are of one kind; those of no particular kind are told apart by their reasons."""
        return other is not None and (
            self == other if self.cause is LossCause.OTHER else self.cause is other.cause
        )


def common_cause(losses: Sequence[DeviceLoss]) -> str:
    """Return why all cameras are lost: the network if none of them answers, and the first camera's reason."""
    first = losses[0].reason
    if all(loss.cause is LossCause.PROCESS_ENDED for loss in losses):
        return first
    if all(loss.cause is LossCause.SILENT for loss in losses):
        advice = "look at the switch, its power and its uplink first"
        return f"all {len(losses)} cameras are gone: {advice}; the first one: {first}"
    return f"all {len(losses)} cameras are lost, the first one: {first}"
