"""What the cameras saw: the types that pass from the drivers to the pipeline.

Times are nanoseconds. `received_ns` is the host's monotonic clock at arrival, `device_ns` the
device's own clock; the two are never subtracted from one another.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from typing import NamedTuple, NewType

import numpy as np
from numpy.typing import NDArray

CameraId = NewType("CameraId", str)
"""Name of a camera's place in the rig, such as `c01`; not the serial number of the device in it."""

CAMERA_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
"""Form of a camera's id, which is part of file names and URLs."""

ZONE = re.compile(r"\[[A-Za-z][A-Za-z0-9._+/-]*\]$")
"""Name of a zone at the end of a time."""

Image = NDArray[np.uint8]
"""Grey image (H, W), row major, pixel centres on integers, (u, v) = (column, row)."""


def rfc3339(moment: datetime | str, timespec: str = "milliseconds") -> str:
    """Return a moment as every file and every answer has it: RFC 3339 in UTC, so that text order is time order.

    A text is any that ISO 8601 allows, in either case (RFC 3339, 5.6), and may name the zone after the offset as Java
    does (RFC 9557): the offset decides.

    Raises
    ------
    ValueError
        The moment has no offset from UTC, or is out of range in UTC.
    """
    given = datetime.fromisoformat(ZONE.sub("", moment).upper()) if isinstance(moment, str) else moment
    if given.tzinfo is None:
        raise ValueError(f"time {str(moment)!r} has no offset from UTC")
    try:
        utc = given.astimezone(UTC)
    except OverflowError:
        raise ValueError(f"time {str(moment)!r} is out of range") from None
    return utc.isoformat(timespec=timespec).replace("+00:00", "Z")


class BundleKind(StrEnum):
    """What a bundle shows."""

    PARTICLE = "particle"
    """A stone, counted by the light gate."""
    BALL = "ball"
    """The matte calibration ball."""
    BACKGROUND = "background"
    """The empty rig, exposed on purpose between stones; no trigger of the light gate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One exposure of one camera."""

    camera: CameraId
    image: Image  # (H, W) uint8, read-only
    frame_id: int  # the camera's own counter: may wrap, jump and restart; reveals loss, never matches
    device_ns: int
    received_ns: int

    def __post_init__(self) -> None:
        if self.image.ndim != 2 or self.image.dtype != np.uint8:
            raise ValueError(f"camera {self.camera}: an image is (H, W) uint8, not {self.image.shape}")
        self.image.setflags(write=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class GateCount:
    """Count of a light gate with a counter of its own, by which a later process knows the stones that it missed."""

    gate: str  # which one, as its driver tells them apart
    sequence: int  # as the gate counts
    device_us: int  # its own time of that, as it sent it
    at: str | None = None  # RFC 3339, where a count is resumed and it is known


class NearStone(NamedTuple):
    """Another stone that passed the light gate so soon before or after that it may be in the same picture."""

    later_ns: int  # than the stone of this trigger, by the gate's clock; negative: before it
    pulse_width_ns: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Trigger:
    """The passing of a stone through the light gate, or an exposure of the empty rig for `BACKGROUND`."""

    sequence: int  # counted by the gate; a gap reveals lost triggers
    received_ns: int
    device_ns: int
    utc: str  # RFC 3339 with Z; for people, never for arithmetic
    pulse_width_ns: int | None = None
    kind: BundleKind = BundleKind.PARTICLE
    name: str | None = None  # of the recorded bundle, in replay
    is_announced: bool = True  # by the gate; False: made up for frames that came without, `utc` still unknown
    gate_count: GateCount | None = None  # with this trigger; None: the gate has no counter of its own
    n_stones: int = 1  # more: as many stones together, which only the gate's counter knows
    near_stones: tuple[NearStone, ...] = ()  # in the order of the gate; filled in as the bundle is completed


class MissingReason(StrEnum):
    """Why a bundle lacks a camera's frame, as decided where frames are joined; drivers give reasons of their own."""

    NO_FRAME = "no_frame"
    """No frame came from the camera until the deadline."""
    CAMERA_LOST = "camera_lost"
    """The camera does not answer."""
    AMBIGUOUS = "ambiguous"
    """Two different frames came for one trigger."""
    OTHER_EXPOSURE = "other_exposure"
    """By its camera's clock the frame was exposed for another trigger."""
    FROZEN = "frozen"
    """The image equals the camera's previous one bit for bit, which no sensor does twice."""
    DEAD_TIME = "dead_time"
    """The trigger followed another within the gate's dead time; the frames belong to the first."""
    DISARMED = "disarmed"
    """The rig was disarmed before the frame came."""
    STONE_PASSED = "stone_passed"
    """The empty rig was exposed while a stone fell."""
    UNSEEN = "unseen"
    """The gate counted the trigger and did not announce it, and no camera exposed."""
    DOWN = "down"
    """The gate counted the trigger while no daemon ran."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameBundle:
    """The frames of one trigger, and the reason why a camera in `missing` has none that is usable."""

    trigger: Trigger
    frames: Mapping[CameraId, Frame]
    missing: Mapping[CameraId, str] = field(default_factory=dict)  # `MissingReason`, or a driver's own
    unreadable: str | None = None
    """What is wrong with the recorded file that the frames should have come from, if none could be read."""

    @property
    def name(self) -> str:
        """Name of the recorded bundle, else the trigger's sequence number."""
        return self.trigger.name or f"{self.trigger.sequence:08d}"

    @property
    def kind(self) -> BundleKind:
        """What the bundle shows."""
        return self.trigger.kind
