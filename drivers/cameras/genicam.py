"""What a GigE camera is set to, in the words of GenICam's standard feature naming convention (SFNC).

Settings are an ordered list of features, written in that order, read back and compared. Cameras
from before SFNC 2 have other names for some of them; the first name the camera knows is used.
"""

from dataclasses import dataclass
from ipaddress import IPv4Address

from pipeline.frames import CAMERA_ID, CameraId

Value = bool | int | float | str
Feature = tuple[str, Value]
"""SFNC name and value in SFNC's unit; for an enumeration the entry's name, for a command `True`."""

OTHER_NAMES: dict[str, tuple[str, ...]] = {
    "AcquisitionFrameRate": ("AcquisitionFrameRateAbs",),
    "DeviceTemperature": ("DeviceTemperatureAbs", "TemperatureAbs"),
    "ExposureTime": ("ExposureTimeAbs",),
    "Gain": ("GainAbs", "GainRaw"),
    "LineDebouncerTime": ("LineDebouncerTimeAbs",),
    "PtpDataSetLatch": ("GevIEEE1588DataSetLatch",),
    "PtpEnable": ("GevIEEE1588",),
    "PtpOffsetFromMaster": ("GevIEEE1588OffsetFromMaster",),
    "PtpStatus": ("GevIEEE1588Status",),
    "TriggerDelay": ("TriggerDelayAbs",),
}
"""The same feature in cameras from before SFNC 2. `GainRaw` alone has another unit, the camera's own steps."""

UNNEEDED: frozenset[Feature] = frozenset(
    {
        ("OffsetX", 0),
        ("OffsetY", 0),
        ("ExposureAuto", "Off"),
        ("Gain", 0.0),
        ("GainAuto", "Off"),
        ("LineMode", "Output"),
        ("TriggerDelay", 0.0),
        ("DeviceLinkThroughputLimitMode", "On"),
    }
)
"""What a camera without the feature does anyway."""

WRITE_ONLY = frozenset({"ActionDeviceKey"})
"""SFNC: whoever may trigger the camera knows the key already."""

_LIMITS = {
    "packet_size_bytes": (576, 9000),
    "packet_delay_ns": (0, 1_000_000_000),
    "throughput_limit_bytes_s": (1, 1 << 40),
    "receive_buffer_bytes": (1, (1 << 31) - 1),  # what the kernel can be told
    "n_buffers": (2, 1000),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class GigeCameraSettings:
    """Which camera is in a place of the rig, and what it is set to.

    Of `serial`, `address` and `user_name` at least one is given; the camera must agree with all that are.
    """

    id: CameraId
    serial: str | None = None
    address: str | None = None  # IPv4
    user_name: str | None = None
    interfaces: tuple[str, ...] = ()  # this machine's IPv4 addresses to look for it; all of them if empty
    image_size_px: tuple[int, int]  # (W, H); the region, from the sensor's corner
    features: tuple[Feature, ...] = ()
    packet_size_bytes: int | None = 8192  # with IP and UDP headers, so the MTU needed; None: negotiated
    packet_delay_ns: int = 0
    throughput_limit_bytes_s: int | None = None
    receive_buffer_bytes: int = 4 << 20  # of the stream's socket
    n_buffers: int = 8  # frames the reader may be behind

    def __post_init__(self) -> None:
        where = f"camera {self.id}"
        if not CAMERA_ID.fullmatch(self.id):
            raise ValueError(f"{where}: an id is letters, digits, _ and -")
        if not (self.serial or self.address or self.user_name):
            raise ValueError(f"{where}: serial, address or user_name must be given")
        for address in (*self.interfaces, *([self.address] if self.address else [])):
            try:
                IPv4Address(address)
            except ValueError as err:
                raise ValueError(f"{where}: {err}") from None
        for name, (low, high) in _LIMITS.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise ValueError(f"{where}: {name} must be in {low}..{high}, not {value}")
        for name, value in self.features:
            if isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
                raise ValueError(f"{where}: feature {name} must have 64 bits, not {value}")
        if min(self.image_size_px) < 1:
            raise ValueError(f"{where}: image_size_px must be positive, not {self.image_size_px}")


def trigger_features(*, source: str, activation: str = "RisingEdge", delay_us: float) -> tuple[Feature, ...]:
    """One frame an edge of `source` (`Line1`), or a `Software` or action command (`Action1`)."""
    edge: tuple[Feature, ...] = (("TriggerActivation", activation),) if source.startswith("Line") else ()
    return (
        ("TriggerSelector", "FrameStart"),
        ("TriggerMode", "On"),  # first and on its own: Aravis issue 1045
        ("TriggerSource", source),
        *edge,
        ("TriggerDelay", float(delay_us)),
    )


def exposure_features(*, exposure_us: float, gain_db: float = 0.0) -> tuple[Feature, ...]:
    """Fixed: a camera that adapts itself changes what the background model has learned."""
    return (
        ("ExposureAuto", "Off"),
        ("ExposureTime", float(exposure_us)),
        ("GainAuto", "Off"),
        ("Gain", float(gain_db)),
    )


def strobe_features(*, line: str) -> tuple[Feature, ...]:
    """`line` is up while the sensor is exposed."""
    return (("LineSelector", line), ("LineMode", "Output"), ("LineSource", "ExposureActive"))


def action_features(*, device_key: int, group_key: int, group_mask: int) -> tuple[Feature, ...]:
    """Act upon action commands with these keys and a bit of this mask."""
    return (
        ("ActionDeviceKey", device_key),
        ("ActionGroupKey", group_key),
        ("ActionGroupMask", group_mask),
    )


def all_features(settings: GigeCameraSettings) -> tuple[Feature, ...]:
    """What is written to the camera, in order: the picture's format, then the configured features."""
    width_px, height_px = settings.image_size_px
    limit = settings.throughput_limit_bytes_s
    return (
        ("AcquisitionMode", "Continuous"),
        ("PixelFormat", "Mono8"),
        ("OffsetX", 0),  # first, for they limit the size
        ("OffsetY", 0),
        ("Width", width_px),
        ("Height", height_px),
        *settings.features,
        *((("DeviceLinkThroughputLimitMode", "On"), ("DeviceLinkThroughputLimit", limit)) if limit else ()),
    )
