"""`[api]` of the configuration: address, keys and limits of the REST interface."""

import re
from dataclasses import dataclass
from enum import StrEnum


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
    """Address of the REST interface, its keys, and the largest request."""

    host: str = "127.0.0.1"
    port: int = 8080
    keys: tuple[ApiKey, ...] = ()  # without any, every host may read and only this machine may write
    max_body_bytes: int = 1_000_000

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise ValueError(f"port must be in 0..65535, not {self.port}")
        if self.max_body_bytes < 1024:
            raise ValueError(f"max_body_bytes must be at least 1024, not {self.max_body_bytes}")
