"""Expose the empty rig, which stones are compared with: after arming, and again while no stone falls."""

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from drivers.errors import GateUnavailableError

log = logging.getLogger(__name__)

POLL_S = 0.1
RETRY_S = 10.0
"""Wait after the gate refused a test pulse."""
QUIET_S = 5.0
"""Time without a stone after which one is unlikely to fall into the exposure, which would lose both."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EmptyRigParameters:
    """Schedule of exposures of the empty rig."""

    at_start: int = 5  # exposures after arming
    every_s: float = 60.0  # while no stone falls; 0: never

    def __post_init__(self) -> None:
        if not 0 <= self.at_start <= 100:
            raise ValueError(f"at_start must be in 0..100, not {self.at_start}")
        if not (self.every_s == 0 or 1 <= self.every_s <= 86_400):
            raise ValueError(f"every_s must be 0 or in 1..86400, not {self.every_s:g}")


async def expose_empty_rig(
    parameters: EmptyRigParameters, fire: Callable[[], Awaitable[None]], is_quiet: Callable[[float], bool]
) -> None:
    """Call `fire` as often as the parameters say, whenever `is_quiet`: no stone for that many seconds, none falling.

    Returns when there is nothing left to do. A gate that fails is asked again every `RETRY_S`, and logged once until it
    has obeyed.
    """
    n_done, due_s, has_failed = 0, time.monotonic(), False
    while n_done < parameters.at_start or parameters.every_s:
        await asyncio.sleep(POLL_S)
        if time.monotonic() < due_s or not is_quiet(0 if n_done < parameters.at_start else QUIET_S):
            continue
        try:
            await fire()
        except GateUnavailableError as err:
            if not has_failed:
                log.warning("the empty rig cannot be exposed: %s", err)
            has_failed = True
            due_s = time.monotonic() + RETRY_S
            continue
        n_done, has_failed = n_done + 1, False
        due_s = time.monotonic() + (0 if n_done < parameters.at_start else parameters.every_s)
