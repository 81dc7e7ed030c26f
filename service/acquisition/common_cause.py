"""Most cameras fail at once: report the common cause instead."""

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.errors import LossCause


@dataclass(frozen=True, slots=True)
class Loss:
    """Why one device is lost."""

    reason: str
    cause: LossCause


def common_cause(losses: Sequence[Loss]) -> str:
    """Say why all cameras are lost: what they have in common if none answers, else what the first one says."""
    if all(loss.cause is LossCause.SILENT for loss in losses):
        return f"all {len(losses)} cameras are gone: look at the switch, its power and its uplink first"
    return f"all {len(losses)} cameras are lost, the first one: {losses[0].reason}"
