"""Settings of a GigE camera, named by GenICam's standard feature naming convention (SFNC).

Settings are an ordered list of features, written in that order, read back and compared. Cameras from before SFNC 2
have other names for some features; the first name that the camera has is used.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from ipaddress import IPv4Address

from pipeline.frames import CAMERA_ID, CameraId

Value = bool | int | float | str
Feature = tuple[str, Value]
"""SFNC name and value in SFNC's unit; for an enumeration the entry's name, for a command `True`."""

OTHER_NAMES: dict[str, tuple[str, ...]] = {
    "AcquisitionBurstFrameCount": ("AcquisitionFrameCount",),
    "AcquisitionFrameRate": ("AcquisitionFrameRateAbs",),
    "AcquisitionFrameRateEnable": ("AcquisitionFrameRateEnabled",),
    "BlackLevel": ("BlackLevelRaw",),
    "DeviceTemperature": ("DeviceTemperatureAbs", "TemperatureAbs"),
    "ExposureTime": ("ExposureTimeAbs",),
    "ExposureTimeMode": ("BslExposureTimeMode",),
    "Gain": ("GainAbs", "GainRaw"),
    "GammaEnable": ("GammaEnabled",),
    "LineDebouncerTime": ("LineDebouncerTimeAbs",),
    "PtpDataSetLatch": ("GevIEEE1588DataSetLatch",),
    "PtpEnable": ("GevIEEE1588",),
    "PtpOffsetFromMaster": ("GevIEEE1588OffsetFromMaster",),
    "PtpStatus": ("GevIEEE1588Status",),
    "TestPattern": ("TestImageSelector",),
    "TriggerDelay": ("TriggerDelayAbs",),
}
"""Names of features in cameras from before SFNC 2, and of vendors. `GainRaw` and `BlackLevelRaw` alone have another
unit, the camera's own steps."""

DEFAULTS_OF_ABSENT: frozenset[Feature] = frozenset(
    {
        ("ExposureAuto", "Off"),
        ("Gain", 0.0),
        ("GainAuto", "Off"),
        ("LineMode", "Output"),
        ("TriggerActivation", "RisingEdge"),
        ("TriggerDelay", 0.0),
        ("TriggerSelector", "FrameStart"),
        ("DeviceLinkThroughputLimitMode", "On"),
    }
)
"""Settings that need not be written to a camera without the feature: it behaves so anyway."""

REMEDIES: dict[str, str] = {
    "AcquisitionBurstFrameCount": "it has no trigger of single frames, only one after which it runs freely",
    "GevSCPSPacketSize": "set packet_size_bytes to a size that all cameras can send",
    "TriggerDelay": "let gate or timer make the delay (rig.delay)",
    "TriggerSource": "set trigger, of the rig or of this camera, to one of them",
}
"""What to do about a setting that comes from elsewhere than from `features`, when a camera cannot do it."""

NEUTRAL: tuple[Feature, ...] = (
    ("SequencerMode", "Off"),  # first: it locks others
    ("ChunkModeActive", False),
    ("ReverseX", False),
    ("ReverseY", False),
    ("BinningHorizontal", 1),
    ("BinningVertical", 1),
    ("DecimationHorizontal", 1),
    ("DecimationVertical", 1),
    ("OffsetX", 0),
    ("OffsetY", 0),
    ("TestPattern", "Off"),
    ("GammaEnable", False),
    ("LUTEnable", False),
    ("LUTMode", "Off"),
    ("Gamma", 1.0),
    ("BlackLevel", 0.0),
    ("ExposureMode", "Timed"),
    ("AcquisitionFrameRateEnable", False),  # it limits triggers, too
    ("TriggerDivider", 1),
)
"""What opening puts back where the camera has the feature and the configuration does not set it: values under which the
image is the sensor's, from its corner, at each trigger."""

GEOMETRY = frozenset(
    name for name, _ in NEUTRAL if name.startswith(("Reverse", "Binning", "Decimation", "Offset", "Test"))
)
"""Neutral features that decide which point of the rig a pixel shows: without them no camera is used."""

SELECTORS: dict[str, str] = {
    "BinningHorizontal": "BinningSelector",
    "BinningVertical": "BinningSelector",
    "BlackLevel": "BlackLevelSelector",
    "DecimationHorizontal": "DecimationSelector",
    "DecimationVertical": "DecimationSelector",
    "LUTEnable": "LUTSelector",
    "TestPattern": "TestPatternGeneratorSelector",
}
"""Neutral features that some cameras have several times, and what selects among them."""

SWITCHES: dict[str, tuple[str, ...]] = {"Gamma": ("GammaEnable", "LUTMode")}
"""Features that have no effect while one of these, which the camera has, is neutral."""

HOST_SOURCES = ("Software", "Action")
"""Beginnings of the trigger sources that are no signal of the camera's own."""

INPUTS = ("Line", "In", "Hardware", "Opt", "TTL")
"""Beginnings of the trigger sources that are wires to the camera, as vendors name them."""

WRITE_ONLY = frozenset({"ActionDeviceKey"})
"""Features that cannot be read back: SFNC makes the key write-only."""

_RANGES = {
    "packet_size_bytes": (576, 9000),
    "packet_delay_ns": (0, 1_000_000_000),
    "throughput_limit_bytes_s": (1, 1 << 40),
    "receive_buffer_bytes": (1, (1 << 31) - 1),  # what the kernel can be told
    "n_buffers": (2, 1000),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class GigeCameraSettings:
    """The camera in one place of the rig, and its settings.

    At least one of `serial`, `address` and `user_name` is given; the camera must agree with all that are given.
    """

    id: CameraId
    serial: str | None = None
    address: str | None = None  # IPv4
    user_name: str | None = None
    interfaces: tuple[str, ...] = ()  # IPv4 addresses of this machine to search from; empty: all
    image_size_px: tuple[int, int]  # (W, H); the region, from the sensor's corner
    features: tuple[Feature, ...] = ()
    packet_size_bytes: int | None = (
        8192  # with IP and UDP headers: the MTU must be so large; None: negotiated
    )
    packet_delay_ns: int = 0
    throughput_limit_bytes_s: int | None = None
    receive_buffer_bytes: int = 4 << 20  # of the stream's socket
    n_buffers: int = 8  # how many frames the reader may lag behind
    is_strobe_off: bool = False  # until it is closed: exposures without the light that its output fires
    may_be_simulated: bool = False  # the rig is a simulated one, and its results are marked

    def __post_init__(self) -> None:
        where = f"camera {self.id}"
        if not CAMERA_ID.fullmatch(self.id):
            raise ValueError(f"{where}: an id consists of letters, digits, _ and -")
        if not (self.serial or self.address or self.user_name):
            raise ValueError(f"{where}: serial, address or user_name must be given")
        for address in (*self.interfaces, *([self.address] if self.address else [])):
            try:
                IPv4Address(address)
            except ValueError as err:
                raise ValueError(f"{where}: {err}") from None
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise ValueError(f"{where}: {name} must be in {low}..{high}, not {value}")
        for name, value in self.features:
            if isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
                raise ValueError(f"{where}: feature {name} must have 64 bits, not {value}")
        if min(self.image_size_px) < 1:
            raise ValueError(f"{where}: image_size_px must be positive, not {self.image_size_px}")


def trigger_features(*, source: str, activation: str = "RisingEdge", delay_us: float) -> tuple[Feature, ...]:
    """Return the features for one frame per edge of `source` (`Line1`, `Timer1Active`) or per command (`Software`)."""
    edge: tuple[Feature, ...] = ()
    if not source.startswith(HOST_SOURCES):
        edge = (("TriggerActivation", activation),)
    return (
        ("TriggerSelector", "FrameStart"),
        ("TriggerMode", "On"),  # first and on its own: Aravis issue 1045
        ("TriggerSource", source),
        *edge,
        ("TriggerDelay", float(delay_us)),
    )


def exposure_features(*, exposure_us: float, gain_db: float = 0.0) -> tuple[Feature, ...]:
    """Return the features for a fixed exposure: automatic ones would change what the background model has learned."""
    return (
        ("ExposureAuto", "Off"),
        ("ExposureTime", float(exposure_us)),
        ("GainAuto", "Off"),
        ("Gain", float(gain_db)),
    )


def strobe_features(*, line: str) -> tuple[Feature, ...]:
    """Return the features that make `line` an output, high while the sensor is exposed."""
    return (("LineSelector", line), ("LineMode", "Output"), ("LineSource", "ExposureActive"))


def strobe_line(settings: Sequence[Feature]) -> str | None:
    """Return the output line that these features have follow the exposure, None without one."""
    line = None
    for name, value in settings:
        if name == "LineSelector":
            line = str(value)
        elif (name, value) == ("LineSource", "ExposureActive"):
            return line
    return None


def action_features(*, device_key: int, group_key: int, group_mask: int) -> tuple[Feature, ...]:
    """Return the features that make the camera obey action commands with these keys and a bit of this mask."""
    return (
        ("ActionDeviceKey", device_key),
        ("ActionGroupKey", group_key),
        ("ActionGroupMask", group_mask),
    )


def all_features(settings: GigeCameraSettings) -> tuple[Feature, ...]:
    """Return all features in the order of writing: the image format, then the configured ones."""
    width_px, height_px = settings.image_size_px
    limit = settings.throughput_limit_bytes_s
    return (
        ("AcquisitionMode", "Continuous"),
        ("PixelFormat", "Mono8"),
        ("Width", width_px),
        ("Height", height_px),
        *settings.features,
        *((("DeviceLinkThroughputLimitMode", "On"), ("DeviceLinkThroughputLimit", limit)) if limit else ()),
    )
