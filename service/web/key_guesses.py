"""The limit of wrong keys from one address; right keys are never refused."""

from collections import OrderedDict
from dataclasses import dataclass

from service.web.clients import origin_of

MAX_WRONG = 10
"""Wrong keys in a row after which an address must wait."""
PAUSE_S = 60.0
"""From the last of them until it may try again; what it tries meanwhile does not count."""
MAX_REMEMBERED = 1024
"""Addresses; the one that was seen least recently is forgotten."""


@dataclass(frozen=True, slots=True)
class WrongKeys:
    """The wrong keys of one address since its last pause."""

    count: int
    last_s: float


class KeyGuesses:
    """Wrong keys by address of the client; times are those of a monotonic clock."""

    def __init__(self) -> None:
        self._wrong: OrderedDict[str, WrongKeys] = OrderedDict()

    def pause_s(self, host: str, now_s: float) -> float:
        """Return the remaining pause of an address, s; 0 when its next wrong key counts as a guess."""
        wrong = self._wrong.get(origin_of(host))
        if wrong is None or wrong.count < MAX_WRONG:
            return 0.0
        return max(0.0, wrong.last_s + PAUSE_S - now_s)

    def note_wrong(self, host: str, now_s: float) -> None:
        """Count a key that is not ours."""
        origin = origin_of(host)
        before = self._wrong.pop(origin, None)
        count = before.count if before is not None and now_s < before.last_s + PAUSE_S else 0
        self._wrong[origin] = WrongKeys(count + 1, now_s)
        if len(self._wrong) > MAX_REMEMBERED:
            self._wrong.popitem(last=False)
