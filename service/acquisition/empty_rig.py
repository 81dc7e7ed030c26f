"""Exposes the empty rig: what a stone is compared with has to be seen without one, at the start and now and then."""

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from drivers.errors import GateUnavailableError

log = logging.getLogger(__name__)

POLL_S = 0.1
RETRY_S = 10.0
STARVED_S = 5.0
"""Without a stone for so long the next one will hardly fall just now: it would be lost with the exposure."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EmptyRigParameters:
    """When the rig is exposed without a stone."""

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
    """Call `fire` as often as asked for, only while `is_quiet`: nothing in the air, no stone for so many seconds.

    Returns when there is nothing to do. A gate that cannot is asked again now and then, and logged once.
    """
    n_done, due_s, problem = 0, time.monotonic(), ""
    while n_done < parameters.at_start or parameters.every_s:
        await asyncio.sleep(POLL_S)
        if time.monotonic() < due_s or not is_quiet(0 if n_done < parameters.at_start else STARVED_S):
            continue
        try:
            await fire()
        except GateUnavailableError as err:
            if str(err) != problem:
                log.warning("the empty rig cannot be exposed: %s", err)
            problem = str(err)
            due_s = time.monotonic() + RETRY_S
            continue
        n_done += 1
        due_s = time.monotonic() + (0 if n_done < parameters.at_start else parameters.every_s)
