"""A part of the daemon, by what the daemon needs of it."""

from collections.abc import Callable
from dataclasses import dataclass

from service.base.status import Checks


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A part of the daemon; what it does not need stays as it is here."""

    checks: Callable[[], Checks] = dict
    """Returns its checks of health as they are now."""
