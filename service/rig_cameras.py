"""All cameras of the rig: opened and armed in threads, tried again when lost, remembered for operators."""

import asyncio
import logging
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import cv2

from drivers.errors import DeviceError
from drivers.interfaces import Camera, CameraLost, DeviceEvent, EventSink
from pipeline.frames import CameraId, Frame, Image
from service.bundling import BundlingCounters, CameraCounters
from service.control import CameraStatus

log = logging.getLogger(__name__)

RETRY_S = 5.0
"""How often a lost camera is asked again; a GigE camera refuses until its owner's heartbeat has run out."""


@dataclass(slots=True)
class _Place:
    """One camera's place in the rig."""

    camera: Camera
    state: str = "closed"
    last_error: str | None = None
    frames: int = 0
    image: Image | None = None
    image_at_s: float = 0.0
    lost_at_s: float = 0.0
    counters: CameraCounters = field(default_factory=CameraCounters)  # of the latest session
    earlier: Counter[str] = field(default_factory=Counter)  # the same, of all sessions before

    def lose(self, reason: str) -> None:
        """Log the loss once, not every failed attempt to undo it."""
        log.log(
            logging.DEBUG if self.state == "lost" else logging.ERROR,
            "camera lost: %s camera=%s",
            reason,
            self.camera.id,
        )
        if self.state != "lost":
            self.lost_at_s = time.monotonic()
        self.state, self.last_error = "lost", reason


class RigCameras:
    """Life cycle of a session: `count`, `arm`, `note` for every event, `close`; meanwhile `retry_lost` as a task."""

    def __init__(self, cameras: Mapping[CameraId, Camera]) -> None:
        self._places = {camera: _Place(device) for camera, device in cameras.items()}

    @property
    def ids(self) -> tuple[CameraId, ...]:
        return tuple(self._places)

    @property
    def armed(self) -> int:
        return sum(place.state == "armed" for place in self._places.values())

    def count(self, counters: BundlingCounters) -> None:
        """Look on while a new session's assembler counts; what those before it came to is kept."""
        for camera, place in self._places.items():
            place.earlier.update(asdict(place.counters))
            place.counters = counters.cameras[camera]

    async def arm(self, sink: EventSink) -> None:
        """Open and arm all cameras at once; one that does not answer is lost for now."""
        await asyncio.gather(*(_open_and_arm(place, sink) for place in self._places.values()))

    async def retry_lost(self, sink: EventSink, leave: asyncio.Event) -> None:
        """Try lost cameras again and again until `leave` is set."""
        while not await is_set_within(leave, RETRY_S):
            lost = [place for place in self._places.values() if place.state == "lost"]
            await asyncio.gather(*(_bring_back(place, sink) for place in lost))

    def note(self, event: DeviceEvent) -> None:
        """Keep the books: the newest frame of each camera, and who is lost."""
        match event:
            case Frame():
                place = self._places[event.camera]
                place.frames += 1
                place.image, place.image_at_s = event.image, time.monotonic()
            case CameraLost():
                self._places[event.camera].lose(event.reason)

    async def close(self) -> None:
        """Disarm and close all cameras."""
        await asyncio.gather(*(_disarm_and_close(place) for place in self._places.values()))

    def statuses(self) -> list[CameraStatus]:
        """State, and counters since the start, of all cameras in page order."""
        now_s = time.monotonic()
        return [
            CameraStatus(
                id=camera,
                state=place.state,
                last_error=place.last_error,
                frames=place.frames,
                lost=place.earlier["lost"] + place.counters.lost,
                late=place.earlier["late"] + place.counters.late,
                duplicates=place.earlier["duplicates"] + place.counters.duplicates,
                last_frame_age_s=None if place.image is None else round(now_s - place.image_at_s, 3),
            )
            for camera, place in self._places.items()
        ]

    async def snapshot(self, camera: CameraId) -> bytes | None:
        """Return the latest frame as PNG, None while there is none."""
        image = self._places[camera].image
        return None if image is None else await asyncio.to_thread(_png, image)


async def is_set_within(event: asyncio.Event, seconds: float) -> bool:
    """Wait for the event, but not longer than `seconds`; whether it is set."""
    try:
        async with asyncio.timeout(seconds):
            await event.wait()
    except TimeoutError:
        return False
    return True


async def _open_and_arm(place: _Place, sink: EventSink) -> None:
    try:
        await asyncio.to_thread(place.camera.open)
        await asyncio.to_thread(place.camera.arm, sink)
    except DeviceError as err:
        place.lose(err.problem)
    else:
        place.state = "armed"


async def _bring_back(place: _Place, sink: EventSink) -> None:
    await asyncio.to_thread(place.camera.close)
    await _open_and_arm(place, sink)
    if place.state == "armed":
        log.info("camera back camera=%s after_s=%.1f", place.camera.id, time.monotonic() - place.lost_at_s)


async def _disarm_and_close(place: _Place) -> None:
    if place.state == "armed":
        await asyncio.to_thread(place.camera.disarm)
        place.state = "closed"
    await asyncio.to_thread(place.camera.close)


def _png(image: Image) -> bytes:
    _, encoded = cv2.imencode(".png", image)
    return encoded.tobytes()
