"""All cameras of the rig: kept at work one by one, watched together, remembered for operators."""

import asyncio
import logging
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial

import cv2
import numpy as np

from drivers.interfaces import Camera, CameraBack, CameraLost, DeviceEvent, EventSink, FrameLost
from pipeline.frames import CameraId, Frame, FrameBundle, Image
from service.acquisition.common_cause import cause_of_all
from service.acquisition.device_keeper import Keeper
from service.acquisition.exposure_skew import ExposureSkew
from service.bundling.counters import BundlingCounters, CameraCounters
from service.bundling.window import CAMERA_LOST, DEAD_TIME, DISARMED, NO_FRAME, STONE_PASSED, UNSEEN
from service.status import CameraStatus, DeviceState

log = logging.getLogger(__name__)

FROZEN = "frozen"
"""The image is the camera's previous one, bit for bit: no sensor does that twice."""
NOT_ITS_FAULT = frozenset({CAMERA_LOST, DEAD_TIME, DISARMED, STONE_PASSED, UNSEEN})
"""Why a bundle has no frame of a camera that is well."""
REOPENED_FOR = {
    NO_FRAME: "answers, but sends no images: look at its trigger line and its settings",
    FROZEN: "sends the same image again and again: switch it off and on",
}
"""What a new session may cure."""
MAX_MISSES = 3
"""So many triggers in a row without an image, and the camera is opened anew although it answers."""
MAX_SKEW_US = 20.0
"""A pixel of fall: the views of a stone would contradict each other."""
FPS_OVER_S = 10.0
RECENT = 64


@dataclass(slots=True)
class _Place:
    """One camera's place in the rig."""

    keeper: Keeper
    frames: int = 0
    image: Image | None = None
    received_s: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))
    latencies_ms: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))
    misses: int = 0  # triggers in a row
    why: str = ""  # of the latest miss
    counters: CameraCounters = field(default_factory=CameraCounters)  # of the latest session
    earlier: Counter[str] = field(default_factory=Counter)  # the same, of all sessions before


class RigCameras:
    """Life of a session: `count`, `arm`; `vet` and `note` for every event, `look_into` every bundle; `close`.

    `is_live`: two images that are equal bit for bit come from a camera that is stuck, not from a recording.
    """

    def __init__(
        self,
        cameras: Mapping[CameraId, Camera],
        *,
        clock: Callable[[], int] = time.monotonic_ns,
        is_live: bool = False,
    ) -> None:
        self._clock = clock  # what the devices' `received_ns` is read from
        self._is_live = is_live
        self._sink: EventSink | None = None
        self._places = {
            camera: _Place(
                Keeper(
                    camera,
                    device,
                    examine=device.examine,
                    on_lost=partial(self._tell_lost, camera),
                    on_back=partial(self._tell_back, camera),
                )
            )
            for camera, device in cameras.items()
        }
        self._skew = ExposureSkew()
        self.blind_triggers = 0
        """Triggers in a row for which no camera that answers had an image."""

    @property
    def ids(self) -> tuple[CameraId, ...]:
        return tuple(self._places)

    @property
    def armed(self) -> int:
        return sum(place.keeper.state is DeviceState.ARMED for place in self._places.values())

    @property
    def lost(self) -> list[CameraId]:
        return [camera for camera, place in self._places.items() if place.keeper.state is DeviceState.LOST]

    def count(self, counters: BundlingCounters) -> None:
        """Look on while a new session's assembler counts; what those before it came to is kept."""
        for camera, place in self._places.items():
            place.earlier.update(asdict(place.counters))
            place.counters = counters.cameras[camera]

    async def arm(self, sink: EventSink, tasks: asyncio.TaskGroup) -> None:
        """Keep all cameras armed from now on; returns when each has been tried."""
        self._sink = sink
        for place in self._places.values():
            place.keeper.start(sink, tasks)
        await asyncio.gather(*(place.keeper.settle() for place in self._places.values()))

    async def close(self) -> None:
        """Disarm and close all cameras."""
        await asyncio.gather(*(place.keeper.end() for place in self._places.values()))

    def abandon(self) -> None:
        """Wait for no camera any longer."""
        for place in self._places.values():
            place.keeper.abandon()

    def trouble(self, min_cameras: int) -> str | None:
        """Why there are too few cameras, None when there are enough."""
        if self.armed >= min_cameras:
            return None
        lost = [place.keeper for place in self._places.values() if place.keeper.state is DeviceState.LOST]
        if len(lost) == len(self._places) > 1:
            return cause_of_all([keeper.last_error for keeper in lost])
        names = ", ".join(keeper.name for keeper in lost)
        why = lost[0].last_error if lost else None
        return f"{names}: {why}; {self.armed} cameras are left of {min_cameras} needed"

    def vet(self, event: DeviceEvent) -> DeviceEvent:
        """Refuse an image that the camera has sent before."""
        if isinstance(event, Frame) and self._is_live:
            before = self._places[event.camera].image
            if before is not None and np.array_equal(before, event.image):
                return FrameLost(camera=event.camera, received_ns=event.received_ns, reason=FROZEN)
        return event

    def note(self, event: DeviceEvent) -> None:
        """Keep the books: the newest frame of each camera, and who is lost."""
        match event:
            case Frame():
                place = self._places[event.camera]
                place.frames += 1
                place.image = event.image
                place.received_s.append(time.monotonic())
            case CameraLost():
                self._places[event.camera].keeper.lose(event.reason)
                self.blind_triggers = 0  # it was not there to have an image
            case CameraBack():
                self._places[event.camera].image = None  # of before; nothing to compare with

    def look_into(self, bundle: FrameBundle) -> None:
        """Learn from a bundle who is in time and who misses; the latter are examined at once."""
        self._skew.feed({camera: frame.device_ns for camera, frame in bundle.frames.items()})
        silent = []
        for camera, place in self._places.items():
            frame = bundle.frames.get(camera)
            if frame is not None:
                place.misses = 0
                place.latencies_ms.append((frame.received_ns - bundle.trigger.received_ns) / 1e6)
            elif place.keeper.state is DeviceState.ARMED and bundle.missing[camera] not in NOT_ITS_FAULT:
                place.why = bundle.missing[camera]
                silent.append((camera, place))
        if bundle.frames:
            self.blind_triggers = 0
        elif silent:  # what all cameras miss is not for each of them to explain
            self.blind_triggers += 1
        for camera, place in silent:
            place.keeper.look()
            if not bundle.frames:
                continue
            place.misses += 1
            if place.misses == MAX_MISSES:
                log.warning("%s camera=%s", _miss_warnings(place)[0], camera)
            if place.misses % MAX_MISSES == 0 and place.why in REOPENED_FOR:
                self._tell_lost(camera, REOPENED_FOR[place.why])

    def statuses(self) -> list[CameraStatus]:
        """State, and counters since the start, of all cameras in page order."""
        now_s = time.monotonic()
        return [
            _status(camera, place, now_s, self._skew.skew_us(camera))
            for camera, place in self._places.items()
        ]

    async def snapshot(self, camera: CameraId) -> bytes | None:
        """Return the latest frame as PNG, None while there is none."""
        image = self._places[camera].image
        return None if image is None else await asyncio.to_thread(_png, image)

    def _tell_lost(self, camera: CameraId, reason: str) -> None:
        if self._sink is not None:
            self._sink.deliver(CameraLost(camera=camera, received_ns=self._clock(), reason=reason))

    def _tell_back(self, camera: CameraId) -> None:
        if self._sink is not None:
            self._sink.deliver(CameraBack(camera=camera, received_ns=self._clock()))


def _status(camera: CameraId, place: _Place, now_s: float, skew_us: float | None) -> CameraStatus:
    keeper, vitals, latencies_ms = place.keeper, place.keeper.vitals, place.latencies_ms
    n_recent = sum(now_s - at_s <= FPS_OVER_S for at_s in place.received_s)

    def total(counter: str) -> int:
        return int(place.earlier[counter] + getattr(place.counters, counter))

    return CameraStatus(
        id=camera,
        state=keeper.state,
        last_error=keeper.last_error,
        recoveries=keeper.recoveries,
        serial=vitals.serial,
        model=vitals.model,
        address=vitals.address,
        frames=place.frames,
        fps=round(n_recent / FPS_OVER_S, 2),
        lost=total("lost"),
        late=total("late"),
        duplicates=total("duplicates"),
        missing=total("missing"),
        strays=total("strays"),
        not_exposed=total("not_exposed"),
        unannounced=total("unannounced"),
        failed_frames=vitals.failed_frames,
        missing_packets=vitals.missing_packets,
        resent_packets=vitals.resent_packets,
        receive_buffer_bytes=vitals.receive_buffer_bytes,
        temperature_c=vitals.temperature_c,
        ptp_offset_ns=vitals.ptp_offset_ns,
        latency_ms=None if not latencies_ms else round(sum(latencies_ms) / len(latencies_ms), 3),
        latency_min_ms=None if not latencies_ms else round(min(latencies_ms), 3),
        latency_max_ms=None if not latencies_ms else round(max(latencies_ms), 3),
        last_frame_age_s=None if not place.received_s else round(now_s - place.received_s[-1], 3),
        skew_us=None if skew_us is None else round(skew_us, 1),
        warnings=(*vitals.warnings, *_skew_warnings(skew_us), *_miss_warnings(place)),
    )


def _skew_warnings(skew_us: float | None) -> tuple[str, ...]:
    if skew_us is None or skew_us <= MAX_SKEW_US:
        return ()
    return (f"exposes {skew_us:.0f} us beside the other cameras: look at its trigger line and its settings",)


def _miss_warnings(place: _Place) -> tuple[str, ...]:
    if place.misses < MAX_MISSES:
        return ()
    return (f"answers, but {place.misses} images in a row could not be used ({place.why})",)


def _png(image: Image) -> bytes:
    _, encoded = cv2.imencode(".png", image)
    return encoded.tobytes()
