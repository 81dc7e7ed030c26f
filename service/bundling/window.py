"""One open trigger: when its frames are expected, which have come, and why others have not."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace

from pipeline.frames import CameraId, Frame, FrameBundle, MissingReason, Trigger

IN_VIEW_NS = 50_000_000
"""A stone within this time after a test pulse is in the picture or at its edge: it crosses the picture in 20 ms."""


TRANSFER_MS = 10.0
"""From an exposure to the middle of a short window, which a frame takes 11 ms to reach, over an uplink of 10 Gb/s 20.

A frame that comes earlier than its exposure was dated wrongly.
"""
MAX_WINDOW_SHARE = 0.45
"""Half width of the window, where only the dead time is set, as a share of that."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BundlingParameters:
    """Times at which frames are expected, and the least time between two triggers."""

    expected_delay_ms: float = 259.4  # trigger delay 247.4, exposure, transfer
    window_ms: float = 100.0  # half width; more than jitter and packet resends take
    dead_time_ms: float = 220.0  # least time between two triggers, as the gate enforces it

    def __post_init__(self) -> None:
        if not 0 <= self.expected_delay_ms <= 10_000:
            raise ValueError(f"expected_delay_ms must be in 0..10000, not {self.expected_delay_ms:g}")
        if not 1 <= self.window_ms <= 5_000:
            raise ValueError(f"window_ms must be in 1..5000, not {self.window_ms:g}")
        if not self.dead_time_ms > 2 * self.window_ms:
            raise ValueError(
                f"dead_time_ms must exceed twice window_ms, {2 * self.window_ms:g}, not {self.dead_time_ms:g}"
            )

    @property
    def quiet_s(self) -> float:
        """Time after a trigger until its stone has left the field of view and the cameras can expose again."""
        return max(self.dead_time_ms, self.expected_delay_ms) / 1e3 + IN_VIEW_NS / 1e9


@dataclass(frozen=True, slots=True, kw_only=True)
class BundlingSettings:
    """`[bundling]` of the configuration; what is not set follows from the rig."""

    expected_delay_ms: float | None = None  # 259.4; for stones in the air together 10 after the exposure
    window_ms: float | None = None  # 100; for stones in the air together 10
    dead_time_ms: float | None = None  # 220, or what cameras are busy for; for stones in the air together 25

    def __post_init__(self) -> None:
        self.over(BundlingParameters())

    def over(self, default: BundlingParameters) -> BundlingParameters:
        """Return the parameters, with the default where nothing is set, and a window that fits a short dead time."""
        set_ms = {name: value for name, value in asdict(self).items() if value is not None}
        if self.dead_time_ms is not None and self.dead_time_ms <= 2 * default.window_ms:
            set_ms.setdefault("window_ms", MAX_WINDOW_SHARE * self.dead_time_ms)
        return replace(default, **set_ms)


@dataclass(slots=True, kw_only=True)
class OpenTrigger:
    """An open trigger whose frames are expected about `expected_ns` of the host's monotonic clock."""

    trigger: Trigger
    ordinal: int  # among triggers that expose
    expected_ns: int
    stalled_ns: int = 0  # how long the host stood still meanwhile, which delays the deadline
    in_dead_time: bool = False  # no camera exposes
    is_spoiled: bool = False  # a background with a stone in it
    frames: dict[CameraId, Frame] = field(default_factory=dict)
    lost: dict[CameraId, str] = field(default_factory=dict)  # cameras that are not waited for, and why
    refused: set[CameraId] = field(default_factory=set)  # cameras that sent only another exposure
    unreadable: str | None = None  # what is wrong with the file that should have been replayed

    def is_complete(self, n_cameras: int) -> bool:
        """True when every camera has delivered or is known not to deliver."""
        return len(self.frames.keys() | self.lost.keys()) == n_cameras

    def bundle(self, cameras: Iterable[CameraId], reason: MissingReason) -> FrameBundle:
        """Return the bundle of what has come, in the order of `cameras`.

        `reason` is given for frames that are missing without a known cause.
        """
        frames: dict[CameraId, Frame] = {}
        missing: dict[CameraId, str] = {}
        for camera in cameras:
            if self.is_spoiled:
                missing[camera] = MissingReason.STONE_PASSED
            elif camera in self.frames:
                frames[camera] = self.frames[camera]
            else:
                unexplained = MissingReason.OTHER_EXPOSURE if camera in self.refused else reason
                missing[camera] = self.lost.get(camera, unexplained)
        return FrameBundle(trigger=self.trigger, frames=frames, missing=missing, unreadable=self.unreadable)
