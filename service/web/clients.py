"""What counts as one client of the REST interface: an address, or a network of IPv6."""

from ipaddress import IPv6Address, ip_network

from starlette.requests import Request

from service.base.addresses import address_of

IPV6_NETWORK_BITS = 64
"""An IPv6 host can choose among the addresses of its network."""


def host_of_client(request: Request) -> str:
    """Return the address that a request comes from, empty when the server does not know it."""
    return "" if request.client is None else request.client.host


def origin_of(host: str) -> str:
    """Return the key under which limits count a client: its address, of IPv6 its /64 network."""
    address = address_of(host)
    if isinstance(address, IPv6Address):
        return str(ip_network((address, IPV6_NETWORK_BITS), strict=False))
    return host if address is None else str(address)
