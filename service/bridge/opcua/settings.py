"""`[opcua]` of the bridge's configuration."""

import re
from dataclasses import dataclass

from service.base.addresses import is_host
from service.base.paths import ConfiguredPath
from service.bridge.opcua.passwords import STORED


@dataclass(frozen=True, slots=True, kw_only=True)
class OpcUaUser:
    """Who may sign in, with a password or a certificate."""

    name: str
    password: str | None = None  # what `stonefall bridge --hash-password` prints
    certificate: ConfiguredPath | None = None  # of the user, DER or PEM
    key_file: ConfiguredPath | None = None  # the daemon's key that orders are given with
    orders: bool = False  # without a key_file: may give orders with the key of the bridge

    def __post_init__(self) -> None:
        if not 1 <= len(self.name) <= 64:
            raise ValueError("name must have 1 to 64 characters")
        if (self.password is None) == (self.certificate is None):
            raise ValueError(f"user {self.name} needs either a password or a certificate")
        if self.password is not None and not re.fullmatch(STORED, self.password):
            raise ValueError(
                f"user {self.name}: password must be what stonefall bridge --hash-password prints"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class OpcUaSettings:
    """Where the OPC UA server listens, and for whom."""

    host: str = "127.0.0.1"  # an address of this machine, 0.0.0.0 for all
    port: int = 4840
    application_uri: str | None = None  # None: made of the name of this machine
    users: tuple[OpcUaUser, ...] = ()

    def __post_init__(self) -> None:
        if not is_host(self.host):
            raise ValueError(f"host must be an address or a name of this machine, not {self.host}")
        if not 0 <= self.port <= 65535:
            raise ValueError("port must be 0 to 65535")
        names = [user.name for user in self.users]
        if len(set(names)) < len(names):
            raise ValueError("users must have different names")
