"""What a simulated camera can be asked and told: one table, from which registers and GenICam XML are made.

Names follow the Standard Features Naming Convention (SFNC); the legacy dialect is the same table with
the names of older cameras, integer registers behind its floats, and values clamped instead of refused.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

Dialect = Literal["sfnc", "legacy"]
Kind = Literal["integer", "float", "scaled", "boolean", "enumeration", "command", "string"]
Access = Literal["RO", "RW", "WO"]

MONO8 = 0x01080001
PTP_STATES = tuple(
    [
        "Initializing",
        "Faulty",
        "Disabled",
        "Listening",
        "PreMaster",
        "Master",
        "Passive",
        "Uncalibrated",
        "Slave",
    ]
)

_WHOLE_WORD = (0, 31)
_NO_ENTRIES: Mapping[str, int] = {}


@dataclass(frozen=True, slots=True, kw_only=True)
class Feature:
    """One feature; numbers are physical, the register holds them divided by `scale`."""

    name: str
    category: str
    kind: Kind = "integer"
    key: str = ""  # what the simulator calls it, in every dialect: the SFNC name
    access: Access = "RW"
    value: int | float = 0  # after power-on
    minimum: float = 0
    maximum: float = 0xFFFFFFFF
    increment: int = 1
    limit: tuple[str, str] | None = None  # keys: the maximum is the first minus the second
    scale: float = 1.0
    unit: str = ""
    entries: Mapping[str, int] = field(default_factory=dict)
    selector: str | None = None  # key of the enumeration that chooses among registers of this feature
    is_locked: bool = False  # not while acquiring
    address: int | None = None  # of a bootstrap register; others are allotted one
    length: int = 4  # bytes
    bits: tuple[int, int] = _WHOLE_WORD  # of the register, 0 = most significant
    is_kept: bool = True  # in user sets

    def __post_init__(self) -> None:
        if not self.key:
            object.__setattr__(self, "key", self.name)
        if self.kind == "float":
            object.__setattr__(self, "length", 8)  # a double


def _enumeration(*names: str) -> Mapping[str, int]:
    return {name: value for value, name in enumerate(names)}


_LINES = _enumeration("Line1", "Line2", "Line3")
_OFF_ONCE_CONTINUOUS = _enumeration("Off", "Once", "Continuous")
TRIGGER_SOURCES = _enumeration("Line1", "Line2", "Line3", "Software", "Action1")
COUNTER_EVENTS = _enumeration("Off", "FrameTrigger", "FrameTriggerMissed", "ExposureStart")
CHUNKS = {"Timestamp": 0x101, "FrameID": 0x102, "ExposureTime": 0x103, "CounterValue": 0x104}
"""Chunk names and their ids on the wire; the image itself is chunk 0x100."""


def sfnc_features(image_size_px: tuple[int, int], *, throughput_bytes_s: int) -> tuple[Feature, ...]:
    """Return the features of a camera with a sensor of `image_size_px`."""
    return (
        *_device(throughput_bytes_s),
        *_image_format(*image_size_px),
        *_acquisition(),
        *_lines_and_counters(),
        *_transport(),
    )


def legacy_features(image_size_px: tuple[int, int], *, throughput_bytes_s: int) -> tuple[Feature, ...]:
    """Return the same features under the names, units and registers of a camera from before SFNC 2.0."""
    return tuple(
        _as_legacy(feature) for feature in sfnc_features(image_size_px, throughput_bytes_s=throughput_bytes_s)
    )


def _device(throughput_bytes_s: int) -> tuple[Feature, ...]:
    category = "DeviceControl"

    def text(name: str, address: int, length: int, access: Access = "RO") -> Feature:
        return Feature(
            name=name, category=category, kind="string", access=access, address=address, length=length
        )

    return (
        text("DeviceVendorName", 0x48, 32),
        text("DeviceModelName", 0x68, 32),
        text("DeviceVersion", 0x88, 32),
        text("DeviceManufacturerInfo", 0xA8, 48),
        text("DeviceSerialNumber", 0xD8, 16),
        text("DeviceUserID", 0xE8, 16, "RW"),
        Feature(
            name="DeviceTemperature",
            category=category,
            kind="float",
            access="RO",
            unit="C",
            minimum=-50,
            maximum=150,
        ),
        Feature(name="DeviceReset", category=category, kind="command", access="WO"),
        Feature(name="TimestampLatch", category=category, kind="command", access="WO"),
        Feature(
            name="TimestampLatchValue",
            category=category,
            access="RO",
            address=0x948,
            length=8,
            maximum=2**63 - 1,
            unit="ns",
        ),
        Feature(
            name="DeviceLinkThroughputLimit",
            category=category,
            value=throughput_bytes_s,
            minimum=100_000,
            maximum=throughput_bytes_s,
            unit="B/s",
        ),
        Feature(
            name="UserSetSelector",
            category="UserSetControl",
            kind="enumeration",
            entries=_enumeration("Default", "UserSet1"),
            is_kept=False,
        ),
        Feature(name="UserSetLoad", category="UserSetControl", kind="command", access="WO", is_locked=True),
        Feature(name="UserSetSave", category="UserSetControl", kind="command", access="WO", is_locked=True),
        Feature(
            name="UserSetDefault",
            category="UserSetControl",
            kind="enumeration",
            entries=_enumeration("Default", "UserSet1"),
            is_kept=False,
        ),
    )


def _image_format(width: int, height: int) -> tuple[Feature, ...]:
    category = "ImageFormatControl"

    def extent(name: str, value: int, *, minimum: int = 0, limit: tuple[str, str], step: int) -> Feature:
        return Feature(
            name=name,
            category=category,
            value=value,
            minimum=minimum,
            maximum=max(width, height),
            increment=step,
            limit=limit,
            is_locked=True,
        )

    return (
        Feature(name="SensorWidth", category=category, access="RO", value=width, maximum=width),
        Feature(name="SensorHeight", category=category, access="RO", value=height, maximum=height),
        extent("Width", width, minimum=16, limit=("SensorWidth", "OffsetX"), step=4),
        extent("Height", height, minimum=2, limit=("SensorHeight", "OffsetY"), step=2),
        extent("OffsetX", 0, limit=("SensorWidth", "Width"), step=4),
        extent("OffsetY", 0, limit=("SensorHeight", "Height"), step=2),
        Feature(
            name="PixelFormat",
            category=category,
            kind="enumeration",
            entries={"Mono8": MONO8},
            value=MONO8,
            is_locked=True,
        ),
        Feature(name="PayloadSize", category=category, access="RO"),
    )


def _acquisition() -> tuple[Feature, ...]:
    category = "AcquisitionControl"

    def trigger(name: str, entries: Mapping[str, int]) -> Feature:
        return Feature(
            name=name, category=category, kind="enumeration", entries=entries, selector="TriggerSelector"
        )

    def automatic(name: str, category: str) -> Feature:
        return Feature(name=name, category=category, kind="enumeration", entries=_OFF_ONCE_CONTINUOUS)

    return (
        Feature(
            name="AcquisitionMode",
            category=category,
            kind="enumeration",
            entries=_enumeration("Continuous", "SingleFrame"),
            is_locked=True,
        ),
        Feature(name="AcquisitionStart", category=category, kind="command", access="WO"),
        Feature(name="AcquisitionStop", category=category, kind="command", access="WO"),
        Feature(name="AcquisitionStatus", category=category, kind="boolean", access="RO"),
        Feature(
            name="AcquisitionFrameRate",
            category=category,
            kind="float",
            value=10.0,
            minimum=0.1,
            maximum=100.0,
            unit="Hz",
        ),
        Feature(name="AcquisitionFrameRateEnable", category=category, kind="boolean"),
        Feature(
            name="TriggerSelector",
            category=category,
            kind="enumeration",
            entries=_enumeration("FrameStart", "FrameBurstStart"),
        ),
        trigger("TriggerMode", _enumeration("Off", "On")),
        trigger("TriggerSource", TRIGGER_SOURCES),
        trigger("TriggerActivation", _enumeration("RisingEdge", "FallingEdge", "AnyEdge")),
        Feature(
            name="TriggerDelay",
            category=category,
            kind="float",
            maximum=1_000_000.0,
            selector="TriggerSelector",
            unit="us",
        ),
        Feature(
            name="TriggerSoftware",
            category=category,
            kind="command",
            access="WO",
            selector="TriggerSelector",
        ),
        Feature(
            name="ExposureTime",
            category=category,
            kind="float",
            value=1000.0,
            minimum=10.0,
            maximum=1_000_000.0,
            unit="us",
        ),
        automatic("ExposureAuto", category),
        Feature(
            name="Gain",
            category="AnalogControl",
            kind="float",
            maximum=24.0,
            unit="dB",
        ),
        automatic("GainAuto", "AnalogControl"),
    )


def _lines_and_counters() -> tuple[Feature, ...]:
    lines, counters, actions = "DigitalIOControl", "CounterAndTimerControl", "ActionControl"

    def line(name: str, entries: Mapping[str, int] = _NO_ENTRIES, kind: Kind = "enumeration") -> Feature:
        return Feature(name=name, category=lines, kind=kind, entries=entries, selector="LineSelector")

    return (
        Feature(name="LineSelector", category=lines, kind="enumeration", entries=_LINES),
        line("LineMode", _enumeration("Input", "Output")),
        line("LineSource", _enumeration("Off", "ExposureActive")),
        line("LineInverter", kind="boolean"),
        Feature(
            name="LineStatus",
            category=lines,
            kind="boolean",
            access="RO",
            selector="LineSelector",
        ),
        Feature(
            name="LineDebouncerTime",
            category=lines,
            kind="float",
            maximum=20_000.0,
            selector="LineSelector",
            unit="us",
        ),
        Feature(
            name="CounterSelector",
            category=counters,
            kind="enumeration",
            entries=_enumeration("Counter1", "Counter2"),
        ),
        Feature(
            name="CounterEventSource",
            category=counters,
            kind="enumeration",
            entries=COUNTER_EVENTS,
            selector="CounterSelector",
            value=COUNTER_EVENTS["FrameTrigger"],
        ),
        Feature(name="CounterValue", category=counters, access="RO", selector="CounterSelector"),
        Feature(
            name="CounterReset",
            category=counters,
            kind="command",
            access="WO",
            selector="CounterSelector",
        ),
        Feature(name="ActionDeviceKey", category=actions, address=0x90C),
        Feature(name="ActionGroupKey", category=actions, address=0x9800),
        Feature(name="ActionGroupMask", category=actions, address=0x9804),
    )


def _transport() -> tuple[Feature, ...]:
    category, chunks = "TransportLayerControl", "ChunkDataControl"
    return (
        Feature(name="ChunkModeActive", category=chunks, kind="boolean", is_locked=True),
        Feature(
            name="ChunkSelector",
            category=chunks,
            kind="enumeration",
            entries=_enumeration(*CHUNKS),
        ),
        Feature(
            name="ChunkEnable",
            category=chunks,
            kind="boolean",
            selector="ChunkSelector",
            value=1,
            is_locked=True,
        ),
        Feature(
            name="GevSCPSPacketSize",
            category=category,
            address=0xD04,
            bits=(16, 31),
            value=1500,
            minimum=220,
            maximum=9000,
            increment=4,
            unit="B",
            is_locked=True,
        ),
        Feature(name="GevSCPSDoNotFragment", category=category, kind="boolean", address=0xD04, bits=(1, 1)),
        Feature(name="GevSCPSFireTestPacket", category=category, kind="boolean", address=0xD04, bits=(0, 0)),
        Feature(name="GevSCPD", category=category, address=0xD08, maximum=100_000_000, unit="ns"),
        Feature(
            name="GevHeartbeatTimeout",
            category=category,
            address=0x938,
            value=3000,
            minimum=500,
            maximum=60_000,
            unit="ms",
            is_kept=False,
        ),
        Feature(
            name="GevGVSPExtendedIDMode",
            category=category,
            kind="enumeration",
            entries=_enumeration("Off", "On"),
            address=0x960,
            bits=(1, 1),
            is_locked=True,
        ),
        Feature(name="PtpEnable", category=category, kind="boolean"),
        Feature(
            name="PtpStatus",
            category=category,
            kind="enumeration",
            access="RO",
            entries=_enumeration(*PTP_STATES),
        ),
        Feature(
            name="PtpOffsetFromMaster",
            category=category,
            access="RO",
            length=8,
            minimum=-(2**63),
            maximum=2**63 - 1,
            unit="ns",
        ),
        Feature(name="PtpDataSetLatch", category=category, kind="command", access="WO"),
        Feature(name="TLParamsLocked", category=category, maximum=1, is_kept=False),
    )


_LEGACY_NAMES = {
    "DeviceSerialNumber": "DeviceID",
    "TimestampLatch": "GevTimestampControlLatch",
    "TimestampLatchValue": "GevTimestampValue",
    "AcquisitionFrameRate": "AcquisitionFrameRateAbs",
    "TriggerDelay": "TriggerDelayAbs",
    "ExposureTime": "ExposureTimeAbs",
    "Gain": "GainRaw",
    "LineDebouncerTime": "LineDebouncerTimeAbs",
    "PtpEnable": "GevIEEE1588",
    "PtpStatus": "GevIEEE1588Status",
    "PtpOffsetFromMaster": "GevIEEE1588OffsetFromMaster",
    "PtpDataSetLatch": "GevIEEE1588DataSetLatch",
}

_LEGACY_STEPS = {
    "AcquisitionFrameRate": 0.01,
    "TriggerDelay": 1.0,
    "ExposureTime": 1.0,
    "LineDebouncerTime": 1.0,
    "DeviceTemperature": 0.1,
}
"""Floats behind an integer register, and what one count of it is worth."""

GAIN_STEP_DB = 0.1
"""What one count of the legacy `GainRaw` is worth."""


def _as_legacy(feature: Feature) -> Feature:
    renamed = replace(feature, name=_LEGACY_NAMES.get(feature.key, feature.name))
    if feature.key in _LEGACY_STEPS:
        return replace(renamed, kind="scaled", length=4, scale=_LEGACY_STEPS[feature.key])
    if feature.key == "Gain":
        return replace(renamed, kind="integer", length=4, scale=GAIN_STEP_DB, unit="")
    if feature.key == "TriggerSelector":
        return replace(renamed, entries=_enumeration("FrameStart", "AcquisitionStart"))
    return renamed
