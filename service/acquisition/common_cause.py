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
        """True if both losses have one cause; losses of cause `OTHER` must have one reason as well."""
        return other is not None and (
            self == other if self.cause is LossCause.OTHER else self.cause is other.cause
        )


def common_cause(losses: Sequence[DeviceLoss]) -> str:
    """Name the cause that all lost cameras share, the network if none answers, and the first camera's reason."""
    first = losses[0].reason
    if all(loss.cause is LossCause.PROCESS_ENDED for loss in losses):
        return first
    if all(loss.cause is LossCause.SILENT for loss in losses):
        advice = "look at the switch, its power and its uplink first"
        return f"all {len(losses)} cameras are gone: {advice}; the first one: {first}"
    return f"all {len(losses)} cameras are lost, the first one: {first}"
