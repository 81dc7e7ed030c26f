"""The description of one feature of a camera, from which registers and GenICam XML are made."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Dialect = Literal["sfnc", "legacy"]
Kind = Literal["integer", "float", "scaled", "boolean", "enumeration", "command", "string"]
Access = Literal["RO", "RW", "WO"]

MONO8 = 0x01080001
PIXEL_FORMATS = {
    "Mono8": MONO8,
    "BayerRG8": 0x01080009,
    "Mono10": 0x01100003,
    "Mono10Packed": 0x010C0004,
    "Mono10p": 0x010A0046,
    "Mono12": 0x01100005,
    "Mono12Packed": 0x010C0006,
    "Mono12p": 0x010C0047,
    "Mono14": 0x01100025,
    "Mono16": 0x01100007,
}
"""Codes of pixel formats (PFNC 2.1): bits 16 to 23 are the bits of a pixel on the wire."""
PTP_STATES = (
    "Initializing",
    "Faulty",
    "Disabled",
    "Listening",
    "PreMaster",
    "Master",
    "Passive",
    "Uncalibrated",
    "Slave",
)

CHUNKS = {"Timestamp": 0x101, "FrameID": 0x102, "ExposureTime": 0x103, "CounterValue": 0x104}
"""Chunk names and their ids on the wire; the image itself is chunk 0x100."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Feature:
    """One feature; numbers are physical values, the register holds them divided by `scale`."""

    name: str
    category: str
    kind: Kind = "integer"
    key: str = ""  # the SFNC name, by which the simulator refers to it in every dialect
    access: Access = "RW"
    value: int | float = 0  # after power-on
    minimum: float = 0
    maximum: float = 0xFFFFFFFF
    increment: int = 1
    limit: tuple[str, str] | None = None  # keys of two features: the maximum is the first minus the second
    bounds: tuple[str, str] | None = None  # keys of two features: the range of a float
    scale: float = 1.0
    unit: str = ""
    entries: Mapping[str, int] = field(default_factory=dict)
    selector: str | None = None  # key of the enumeration that chooses among registers of this feature
    is_locked: bool = False  # not writable while acquiring
    address: int | None = None  # of a bootstrap register; None: one is allotted
    length: int = 4  # bytes
    bits: tuple[int, int] = (0, 31)  # of the register, 0 = most significant
    is_kept: bool = True  # saved in user sets

    def __post_init__(self) -> None:
        if not self.key:
            object.__setattr__(self, "key", self.name)
        if self.kind == "float":
            object.__setattr__(self, "length", 8)  # a double
