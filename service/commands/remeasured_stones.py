"""Outcomes of the stones of `stonefall remeasure`."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from service.commands.daemon_client import DaemonError
from service.remeasuring.hindrance import Hindrance


@dataclass(slots=True)
class RemeasuredIds:
    """The ids of the stones, by outcome."""

    revised: list[str] = field(default_factory=list)
    unchanged: list[str] = field(default_factory=list)
    without_frames: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)  # with the reason


@contextmanager
def noted_refusal(name: str, summary: RemeasuredIds) -> Iterator[None]:
    """Note why a daemon refuses to measure a stone again; what is about no stone is raised on."""
    try:
        yield
    except DaemonError as err:
        if err.kind == Hindrance.NO_FRAMES:
            summary.without_frames.append(name)
        elif err.kind in (Hindrance.NO_CALIBRATION, Hindrance.FAILED):
            summary.failed[name] = str(err)
        else:  # the daemon stops, the key is wrong, the rig was never empty
            raise
