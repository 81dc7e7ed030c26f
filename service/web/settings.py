"""`[api]` of the configuration: address, keys and limits of the REST interface."""

import re
from dataclasses import dataclass
from enum import StrEnum
from ipaddress import ip_network

from service.base.addresses import address_of, is_host, is_loopback
from service.base.schema import Live, require_ranges

PREFIX = re.compile(r"(/[A-Za-z0-9_-]+)*")
"""Path at which a proxy may have the service; empty without one."""
OWN_PATHS = (
    *("api", "compare", "gallery", "laboratory", "lots"),
    *("screens", "setup", "shift", "sign-in", "stones", "verify"),
)
"""First parts of our own paths, which a prefix would hide."""


class Scope(StrEnum):
    """Permission that a key can have. None includes another."""

    READ = "read"
    """Read everything."""
    OPERATE = "operate"
    """Arm and disarm, record, collect and solve calibrations, verify, open and close lots, acknowledge alarms,
    measure stones again."""
    CONFIGURE = "configure"
    """Accept and activate calibrations, define products, read the configuration."""


class Role(StrEnum):
    """What a screen is for that is signed in by a code."""

    DISPLAY = "display"
    """Only reads, and stays signed in until its key is revoked."""
    OPERATOR = "operator"
    """Reads and operates."""
    ENGINEER = "engineer"
    """May do all."""

    @property
    def scopes(self) -> tuple[Scope, ...]:
        """Scopes of its key."""
        return tuple(Scope)[: tuple(Role).index(self) + 1]


class WithoutKeys(StrEnum):
    """What hosts of the network may do while there is no key."""

    NOTHING = "only this machine may ask"
    EVERY_HOST_MAY_READ = "every host may read"


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiKey:
    """A bearer token, of which only the hash is stored."""

    name: str
    sha256: str  # hex digest of the token
    scopes: tuple[Scope, ...] = (Scope.READ,)

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[0-9a-f]{64}", self.sha256):
            raise ValueError(f"key {self.name!r}: sha256 must be 64 lower-case hexadecimal digits")


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiSettings:
    """Address and names of the REST interface, its keys, and the largest request."""

    host: str = "127.0.0.1"
    port: int = 8080
    allowed_hosts: tuple[str, ...] = ()  # further names by which clients ask for this service
    keys: Live[tuple[ApiKey, ...]] = ()  # more of them are made by `stonefall keys`
    without_keys: WithoutKeys = WithoutKeys.NOTHING  # only this machine may write, whatever stands here
    path_prefix: str = ""  # path at which a proxy has this service, such as /stonefall
    trusted_proxies: tuple[str, ...] = ()  # addresses and networks whose X-Forwarded-For says who asks
    loopback_reads_without_key: bool = False  # requests from this machine may read, although there are keys
    max_body_bytes: int = 1_000_000

    def __post_init__(self) -> None:
        if not is_host(self.host):
            raise ValueError(f"host must be an address or a host name, not {self.host!r}")
        for name in self.allowed_hosts:
            if not is_host(name):
                raise ValueError(f"allowed_hosts: must be names or addresses without a port, not {name!r}")
        first = self.path_prefix[1:].partition("/")[0]
        if not PREFIX.fullmatch(self.path_prefix) or first in OWN_PATHS:
            wanted = "a path such as /stonefall, without a slash at its end, and none of our own"
            raise ValueError(f"path_prefix must be {wanted}, not {self.path_prefix!r}")
        for proxy in self.trusted_proxies:
            try:
                ip_network(proxy)
            except ValueError as err:
                raise ValueError(f"trusted_proxies: {err}") from None
        require_ranges(self, port=(0, 65535))
        if self.max_body_bytes < 1024:
            raise ValueError(f"max_body_bytes must be at least 1024, not {self.max_body_bytes}")

    @property
    def local_url(self) -> str:
        """Where this machine reaches the service; one that listens on every interface does so on loopback as well."""
        host, address = self.host, address_of(self.host)
        if address is not None and address.is_unspecified:
            host = "127.0.0.1" if address.version == 4 else "::1"
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}"

    @property
    def may_read_without_keys(self) -> bool:
        """True when every host that reaches the service may read while there is no key.

        On loopback that is only this machine, and those whom a proxy on it lets through.
        """
        return is_loopback(self.host) or self.without_keys is WithoutKeys.EVERY_HOST_MAY_READ
