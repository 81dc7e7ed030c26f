"""Most cameras fail at once: report the common cause instead of every camera."""

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.errors import LossCause


@dataclass(frozen=True, slots=True)
class DeviceLoss:
    """The reason and the kind of cause for which a device is lost."""

    reason: str
    cause: LossCause


def common_cause(losses: Sequence[DeviceLoss]) -> str:
    """Return why all cameras are lost: the network if none of them answers, else the first camera's reason."""
    if all(loss.cause is LossCause.PROCESS_ENDED for loss in losses):
        return losses[0].reason
    if all(loss.cause is LossCause.SILENT for loss in losses):
        return f"all {len(losses)} cameras are gone: look at the switch, its power and its uplink first"
    return f"all {len(losses)} cameras are lost, the first one: {losses[0].reason}"
