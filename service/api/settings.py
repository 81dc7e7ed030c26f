"""The part of the configuration that the REST interface needs."""

import re
from dataclasses import dataclass
from enum import StrEnum


class Scope(StrEnum):
    """What a key opens."""

    READ = "read"
    """Results, particles, health."""
    OPERATE = "operate"
    """Arm and disarm."""
    CONFIGURE = "configure"
    """What outlives a shift: keys, calibrations, settings."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiKey:
    """A bearer token, known by its hash alone."""

    name: str
    sha256: str  # hex digest of the token
    scopes: tuple[Scope, ...] = (Scope.READ,)

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[0-9a-f]{64}", self.sha256):
            raise ValueError(f"key {self.name!r}: sha256 must be 64 lower-case hexadecimal digits")


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiSettings:
    """Where the REST interface listens, who may use it and how much of it at once."""

    host: str = "127.0.0.1"
    port: int = 8080
    keys: tuple[ApiKey, ...] = ()  # none: everybody may read, only this machine may write
    max_body_bytes: int = 1_000_000

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise ValueError(f"port must be in 0..65535, not {self.port}")
        if self.max_body_bytes < 1024:
            raise ValueError(f"max_body_bytes must be at least 1024, not {self.max_body_bytes}")
