"""What counts as one client of the REST interface, an address or a network of IPv6, and how often it may try."""

import math
from collections import OrderedDict
from ipaddress import IPv6Address, ip_network

from starlette.requests import Request

from service.base.addresses import address_of
from service.base.schema import served
from service.web.problems import Problem

IPV6_NETWORK_BITS = 64
"""An IPv6 host can choose among the addresses of its network."""
MAX_WRONG = 10
"""Wrong keys in a row after which an address must wait; right keys are never refused."""
PAUSE_S = 60.0
"""From the last of them until it may try again; what it tries meanwhile does not count."""
MOST_KEYLESS = 32
"""Clients that are remembered by who asks without a key."""
MOST_CHARACTERS = 200
"""Longest name of a browser that is kept."""
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


def agent_of(request: Request) -> str:
    """Return the `User-Agent` of a request, as far as it can be shown."""
    text = request.headers.get("user-agent", "")[:MOST_CHARACTERS]
    return "".join(each for each in text if each.isprintable())


def pause_problem(what: str, host: str, pause_s: float) -> Problem:
    """Return the problem 429 of an address that has tried too often; `what` says of what it was."""
    wait_s = math.ceil(pause_s)
    detail = f"too many {what} from {host}: try again in {wait_s} s"
    return Problem(429, "too-many-attempts", detail, retry_after_s=wait_s)


@served
class Client:
    """A browser or program, by what is known of it."""

    address: str
    """Network address that it asks from"""
    user_agent: str
    """The name that the client gives itself; empty without one"""


class Keyless:
    """Clients that asked without a key while there was none."""

    def __init__(self) -> None:
        self._seen: OrderedDict[Client, None] = OrderedDict()

    def note(self, request: Request) -> None:
        """Remember the client of a request."""
        client = Client(address=host_of_client(request), user_agent=agent_of(request))
        self._seen[client] = None
        self._seen.move_to_end(client)
        if len(self._seen) > MOST_KEYLESS:
            self._seen.popitem(last=False)

    def newest(self) -> list[Client]:
        """Return them, the newest first."""
        return list(reversed(self._seen))


class Attempts:
    """Attempts that are limited, such as wrong keys, by address of the client; times are of a monotonic clock."""

    def __init__(self) -> None:
        self._wrong: OrderedDict[str, tuple[int, float]] = (
            OrderedDict()
        )  # their number, and when the last one came

    def pause_s(self, host: str, now_s: float) -> float:
        """Return the remaining pause of an address, s; 0 when its next attempt counts."""
        count, last_s = self._wrong.get(origin_of(host), (0, now_s))
        return max(0.0, last_s + PAUSE_S - now_s) if count >= MAX_WRONG else 0.0

    def note(self, host: str, now_s: float) -> None:
        """Count an attempt, such as a key that is not ours."""
        count, last_s = self._wrong.pop(origin_of(host), (0, now_s))
        self._wrong[origin_of(host)] = (count + 1 if now_s < last_s + PAUSE_S else 1, now_s)
        if len(self._wrong) > MAX_REMEMBERED:
            self._wrong.popitem(last=False)
