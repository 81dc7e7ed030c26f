"""Bound how many wrong keys an address can try, without shutting out who has a right one."""

from collections import OrderedDict
from dataclasses import dataclass
from ipaddress import IPv6Address, ip_network

from service.addresses import address_of

MAX_WRONG = 10
"""Wrong keys in a row after which an address must wait."""
PAUSE_S = 60.0
"""From the last of them until it may try again; what it tries meanwhile does not count."""
MAX_REMEMBERED = 1024
"""Addresses of either kind; the one that was seen least recently is forgotten."""
IPV6_NETWORK_BITS = 64
"""An IPv6 host can choose among the addresses of its network."""


@dataclass(frozen=True, slots=True)
class WrongKeys:
    """The wrong keys of one address since its last right one or its last pause."""

    count: int
    last_s: float


class KeyGuesses:
    """What the addresses of clients have tried; times are those of a monotonic clock."""

    def __init__(self) -> None:
        self._wrong: OrderedDict[str, WrongKeys] = OrderedDict()
        self._right: OrderedDict[tuple[str, str], None] = OrderedDict()

    def pause_s(self, host: str, key: str | None, now_s: float) -> float:
        """Return how long this client must wait before its key is looked at, 0 if it need not.

        A `key` that was right from there before never waits: others behind the same proxy may guess for ever.
        """
        origin = origin_of(host)
        if key is not None and (origin, key) in self._right:
            return 0.0
        wrong = self._wrong.get(origin)
        if wrong is None or wrong.count < MAX_WRONG:
            return 0.0
        return max(0.0, wrong.last_s + PAUSE_S - now_s)

    def note_wrong(self, host: str, now_s: float) -> None:
        """Count a key that was looked at and is not ours."""
        origin = origin_of(host)
        before = self._wrong.pop(origin, None)
        count = before.count if before is not None and now_s < before.last_s + PAUSE_S else 0
        self._wrong[origin] = WrongKeys(count + 1, now_s)
        if len(self._wrong) > MAX_REMEMBERED:
            self._wrong.popitem(last=False)

    def note_right(self, host: str, key: str) -> None:
        """Forget the wrong keys of this address, and remember the name of its right one."""
        origin = origin_of(host)
        self._wrong.pop(origin, None)
        self._right[origin, key] = None
        self._right.move_to_end((origin, key))
        if len(self._right) > MAX_REMEMBERED:
            self._right.popitem(last=False)


def origin_of(host: str) -> str:
    """Return what is counted as one client: an address, or a network of IPv6."""
    address = address_of(host)
    if isinstance(address, IPv6Address):
        return str(ip_network((address, IPV6_NETWORK_BITS), strict=False))
    return host if address is None else str(address)
