"""`[modbus]` and `[gpio]` of the bridge's configuration."""

from dataclasses import dataclass

from service.base.addresses import is_host
from service.base.schema import require_ranges
from service.bridge.contacts.points import Contact


@dataclass(frozen=True, slots=True, kw_only=True)
class ModbusSettings:
    """Where the registers are served; Modbus knows no keys: every host that reaches the port reads them."""

    host: str = "127.0.0.1"
    port: int = 1502  # 502, that of the standard, needs a capability: see the guide
    max_clients: int = 16
    idle_s: float = 60.0  # a client that asks nothing for so long is disconnected

    def __post_init__(self) -> None:
        if not is_host(self.host):
            raise ValueError(f"host must be a name or an address of this machine, not {self.host}")
        require_ranges(self, port=(1, 65535), max_clients=(1, 100), idle_s=(1, 3600))


@dataclass(frozen=True, slots=True, kw_only=True)
class GpioSettings:
    """Output lines of one GPIO chip, each with the contact that it shows."""

    chip: str  # such as /dev/gpiochip0
    lines: dict[str, Contact]  # by offset or name
    active_low: bool = False  # all lines: low is on

    def __post_init__(self) -> None:
        if not self.chip:
            raise ValueError("chip must be named, such as /dev/gpiochip0")
        if not self.lines:
            raise ValueError('lines must have one at least, such as 17 = "rig_ready"')
