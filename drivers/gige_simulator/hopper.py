"""The stones of a recording in the order in which they fall, decompressed ahead.

Decompressing one takes 0.1 s of the processor that sixteen cameras need to be on time: as many as fit into
`AHEAD_BYTES` are ready before they fall.
"""

import queue
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from drivers.errors import RecordingError
from drivers.files.recording import BundleHeader, Recording, playback_order, read_bundle, unreadable_triggers
from pipeline.frames import BundleKind, CameraId, Image, Trigger

AHEAD_BYTES = 512 << 20
"""Limit of images in memory, 24 bundles of full size; a looping recording that fits is decompressed only once."""
PULSE_WIDTH_NS = 64_000_000
"""Pulse width where none was recorded: a stone of 20 mm, the middle of the product, that begins to fall at the beam."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drop:
    """One stone, or an exposure of the empty rig, where no stone falls."""

    is_empty: bool
    pulse_width_ns: int
    images: Mapping[CameraId, Image]  # what each camera sees; a camera without an image sends none


class Hopper:
    """Hands out the stones one by one; its thread runs from `start` to `close`.

    A bundle that cannot be read is a stone that no camera sees; those without a readable header fall once,
    after the first round.
    """

    def __init__(self, recording: Recording, *, is_looping: bool = False, only_stones: bool = False) -> None:
        self._recording = recording
        self._headers = [
            header
            for header in playback_order(recording)
            if not (only_stones and header.kind is BundleKind.BACKGROUND)
        ]
        self._is_looping = is_looping
        width_px, height_px = recording.image_size_px
        n_ahead = max(1, AHEAD_BYTES // (len(recording.camera_ids) * width_px * height_px))
        self._kept: dict[int, Drop] | None = {} if is_looping and len(self._headers) <= n_ahead else None
        self._falls: queue.Queue[Drop | None] = queue.Queue(n_ahead)
        self._is_closing = threading.Event()
        self._thread = threading.Thread(target=self._read_ahead, name="hopper", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def take(self) -> Drop | None:
        """Wait for the next stone and return it; None after the last one and when the hopper is closed."""
        return self._falls.get()

    def close(self) -> None:
        self._is_closing.set()
        while self._thread.is_alive():
            self._drain()  # the reader may be waiting for room
            self._thread.join(0.02)
        self._drain()
        self._falls.put(None)

    def _drain(self) -> None:
        while not self._falls.empty():
            self._falls.get_nowait()

    def _read_ahead(self) -> None:
        for fall in self._all():
            if self._is_closing.is_set():
                return
            self._falls.put(fall)
        self._falls.put(None)

    def _all(self) -> Iterator[Drop]:
        yield from self._one_round()
        for trigger, _ in unreadable_triggers(self._recording):
            yield _unseen(trigger)
        while self._is_looping:
            yield from self._one_round()

    def _one_round(self) -> Iterator[Drop]:
        for index, header in enumerate(self._headers):
            if self._kept is not None and index in self._kept:
                yield self._kept[index]
                continue
            fall = read_fall(header, self._recording)
            if self._kept is not None:
                self._kept[index] = fall
            yield fall


def read_fall(header: BundleHeader, recording: Recording) -> Drop:
    """Return the fall of a recorded bundle: its trigger, and the images of its cameras as far as they can be read."""
    try:
        bundle = read_bundle(header.path, recording.camera_ids)
    except RecordingError:
        return _unseen(header.trigger)
    return _fall(bundle.trigger, {camera: frame.image for camera, frame in bundle.frames.items()})


def _unseen(trigger: Trigger) -> Drop:
    return _fall(trigger, {})


def _fall(trigger: Trigger, images: Mapping[CameraId, Image]) -> Drop:
    return Drop(
        is_empty=trigger.kind is BundleKind.BACKGROUND,
        pulse_width_ns=trigger.pulse_width_ns or PULSE_WIDTH_NS,
        images=images,
    )
