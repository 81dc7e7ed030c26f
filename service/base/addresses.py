"""Names and addresses of hosts, as they stand in the configuration, in URLs and in sockets."""

import re
from ipaddress import IPv4Address, IPv6Address, ip_address
from urllib.parse import urlsplit

LABEL = r"(?!-)[A-Za-z0-9_-]{1,63}(?<!-)"
HOST_NAME = re.compile(rf"(?=.{{1,253}}$)({LABEL}\.)*(?!\d+$){LABEL}")
"""The last label is no number: `256.1.1.1` would be a misspelt address."""


def address_of(host: str) -> IPv4Address | IPv6Address | None:
    """Return the address that a text is, an IPv4 one in IPv6 (`::ffff:192.0.2.1`) as itself; None for names."""
    try:
        address = ip_address(host.partition("%")[0])  # without the interface of a link-local one
    except ValueError:
        return None
    return address.ipv4_mapped or address if isinstance(address, IPv6Address) else address


def is_host(text: str) -> bool:
    """True for an IP address or a valid host name."""
    return address_of(text) is not None or HOST_NAME.fullmatch(text) is not None


def is_loopback(host: str) -> bool:
    """True when a host name or address is loopback, without asking a name server."""
    address = address_of(host)
    return host == "localhost" if address is None else address.is_loopback


def host_of(netloc: str) -> str:
    """Return the host of `host:port` in lower case; empty when there is none to be read."""
    try:
        return (urlsplit(f"//{netloc}").hostname or "").removesuffix(".")
    except ValueError:  # an unmatched bracket
        return ""
