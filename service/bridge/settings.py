"""The configuration of the bridge: one TOML file, with a table for each outlet that is wanted."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Self
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, model_validator

from service.base.addresses import is_host
from service.base.paths import ConfiguredPath
from service.base.settings_file import load_settings_file
from service.bridge.contacts.settings import GpioSettings, ModbusSettings
from service.bridge.mqtt.settings import MqttSettings
from service.bridge.opcua.settings import OpcUaSettings

OUTLETS = {
    "opcua": "service.bridge.opcua.outlet",
    "mqtt": "service.bridge.mqtt.outlet",
    "modbus": "service.bridge.contacts.modbus",
    "gpio": "service.bridge.contacts.gpio",
}
"""Tables of which one at least is there, and the module with the coroutine function `run` of each."""
CONSUMER = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,39}")
"""Beginning of the names of consumers, `NEW_ID` with room for an outlet's name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DaemonSettings:
    """The daemon whose client the bridge is."""

    url: str = "http://127.0.0.1:8080"
    key_file: ConfiguredPath | None = (
        None  # of a token with the scope read, and operate for lots, alarms, cursors
    )
    consumer: str | None = (
        None  # parks the cursor of each outlet as consumer CONSUMER-OUTLET, which needs operate
    )

    def __post_init__(self) -> None:
        if not _is_url(self.url):
            raise ValueError(f"url must be an address such as http://127.0.0.1:8080, not {self.url}")
        if self.consumer is not None and not CONSUMER.fullmatch(self.consumer):
            raise ValueError(
                f"consumer must be 1 to 40 letters of A to Z, digits, _ . or -, not {self.consumer}"
            )


def _is_url(text: str) -> bool:
    try:
        parts = urlsplit(text)
        _ = parts.port
    except ValueError:
        return False
    return parts.scheme in ("http", "https") and is_host(parts.hostname or "")


class BridgeSettings(BaseModel):
    """The whole file: each table is a field, unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    dir: ConfiguredPath
    """Folder of what outlasts a restart: cursors, certificates; each outlet has a folder of its name in it."""
    daemon: DaemonSettings = DaemonSettings()
    opcua: OpcUaSettings | None = None
    mqtt: MqttSettings | None = None
    modbus: ModbusSettings | None = None
    gpio: GpioSettings | None = None

    @model_validator(mode="after")
    def _has_an_outlet(self) -> Self:
        if not self.outlets:
            raise ValueError(
                f"needs a table of what is to be served: {', '.join(f'[{each}]' for each in OUTLETS)}"
            )
        return self

    @property
    def outlets(self) -> tuple[str, ...]:
        """Names of the outlets that the file has a table of."""
        return tuple(name for name in OUTLETS if getattr(self, name) is not None)


def load_bridge_settings(path: Path) -> BridgeSettings:
    """Read and check the file; raise `SettingsError`, which names it and each wrong field."""
    return load_settings_file(path, BridgeSettings)
