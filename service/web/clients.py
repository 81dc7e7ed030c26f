"""What counts as one client of the REST interface, an address or a network of IPv6, and how often it may guess keys."""

from collections import OrderedDict
from ipaddress import IPv6Address, ip_network

from starlette.requests import Request

from service.base.addresses import address_of

IPV6_NETWORK_BITS = 64
"""An IPv6 host can choose among the addresses of its network."""
MAX_WRONG = 10
"""Wrong keys in a row after which an address must wait; right keys are never refused."""
PAUSE_S = 60.0
"""From the last of them until it may try again; what it tries meanwhile does not count."""
MAX_REMEMBERED = 1024
"""Addresses; the one that was seen least recently is forgotten."""


def host_of_client(request: Request) -> str:
    """Return the address that a request comes from, empty when the server does not know it."""
    return "" if request.client is None else request.client.host


def origin_of(host: str) -> str:
    """Return the key under which limits count a client: its address, of IPv6 its /64 network."""
    address = address_of(host)
    if isinstance(address, IPv6Address):
        return str(ip_network((address, IPV6_NETWORK_BITS), strict=False))
    return host if address is None else str(address)


class KeyGuesses:
    """Wrong keys by address of the client; times are those of a monotonic clock."""

    def __init__(self) -> None:
        self._wrong: OrderedDict[str, tuple[int, float]] = (
            OrderedDict()
        )  # their number, and when the last one came

    def pause_s(self, host: str, now_s: float) -> float:
        """Return the remaining pause of an address, s; 0 when its next wrong key counts as a guess."""
        count, last_s = self._wrong.get(origin_of(host), (0, now_s))
        return max(0.0, last_s + PAUSE_S - now_s) if count >= MAX_WRONG else 0.0

    def note_wrong(self, host: str, now_s: float) -> None:
        """Count a key that is not ours."""
        count, last_s = self._wrong.pop(origin_of(host), (0, now_s))
        self._wrong[origin_of(host)] = (count + 1 if now_s < last_s + PAUSE_S else 1, now_s)
        if len(self._wrong) > MAX_REMEMBERED:
            self._wrong.popitem(last=False)
