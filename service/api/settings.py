"""`[api]` of the configuration: address, keys and limits of the REST interface."""

import re
from dataclasses import dataclass
from enum import StrEnum

from service.api.addresses import is_host, is_loopback


class Scope(StrEnum):
    """Permission that a key can have. None includes another."""

    READ = "read"
    """Read everything."""
    OPERATE = "operate"
    """Arm and disarm, record, collect and solve calibrations, verify."""
    CONFIGURE = "configure"
    """Accept and activate calibrations."""


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
    keys: tuple[ApiKey, ...] = ()  # without any, every host may read and only this machine may write
    max_body_bytes: int = 1_000_000

    def __post_init__(self) -> None:
        if not is_host(self.host):
            raise ValueError(f"host must be an address or a host name, not {self.host!r}")
        for name in self.allowed_hosts:
            if not is_host(name):
                raise ValueError(f"allowed_hosts: must be names or addresses without a port, not {name!r}")
        if not 0 <= self.port <= 65535:
            raise ValueError(f"port must be in 0..65535, not {self.port}")
        if self.max_body_bytes < 1024:
            raise ValueError(f"max_body_bytes must be at least 1024, not {self.max_body_bytes}")

    @property
    def warning(self) -> str | None:
        """Return why the network may do too much, None when it may not."""
        if self.keys or is_loopback(self.host):
            return None
        return f"every host that reaches {self.host} may read everything: configure [[api.keys]]"
