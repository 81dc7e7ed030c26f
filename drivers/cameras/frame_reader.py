"""The thread that pulls a camera's frames from Aravis and delivers them without a copy.

Frames are pulled, not pushed: a callback or signal would run in Aravis' receive thread and cost packets. The memory
that a frame was received into becomes its image, and Aravis gets a buffer with other memory at once. A buffer with
any status but success is a lost frame.
"""

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.cameras.pixel_formats import PixelFormat
from drivers.errors import LossCause
from drivers.interfaces import CameraLost, EventSink, FrameLost
from pipeline.frames import CameraId, Frame, Image

POP_US = 50_000
"""Longest wait for one frame, and so the longest duration of `stop`."""
Memory = dict[int, NDArray[np.uint8]]
"""Arrays (N,) that the buffers held by Aravis receive into, by the hash of the buffer, which is its address."""
LATEST_LOSS_NS = 500_000_000
"""A loss is reported at most so long after its leader; an older time stamp is a leftover of the buffer."""
OLDEST_NS = 1_000_000_000
"""Greatest age of a frame; it is exceeded only if the wall clock was set after its leader arrived."""
CHUNKS = "its images come as chunk data (payload type 4), which is not read: switch chunk mode off (ChunkModeActive)"
"""Reason of a lost frame in which Aravis finds no image, as in chunk mode of GigE Vision 1."""

Allocate = Callable[[int], NDArray[np.uint8] | None]
"""Returns an array (N,) of so many bytes or more to receive into, None when there is none at present."""


def allocate(n_bytes: int) -> NDArray[np.uint8]:
    """Return a new array (N,)."""
    return np.empty(n_bytes, np.uint8)


def new_buffer(aravis: Any, n_bytes: int, memory: Memory, allocate: Allocate) -> Any | None:
    """Return an `aravis.Buffer` of `n_bytes` that receives into an array, which is added to `memory`."""
    pixels = allocate(n_bytes)
    if pixels is None:
        return None
    buffer = aravis.Buffer.new(n_bytes, pixels.ctypes.data)
    memory[hash(buffer)] = pixels
    return buffer


class FrameReader:
    """Reads one stream from `start` to `stop`; once `stop` returns nothing more is delivered."""

    def __init__(
        self,
        camera: CameraId,
        stream: Any,
        *,
        memory: Memory,
        make_buffer: Callable[[], Any | None],
        image_size_px: tuple[int, int],
        control_lost: threading.Event,
        pixel_format: PixelFormat | None = None,
    ) -> None:
        self._camera = camera
        self._stream = stream
        self._memory = memory
        self._make_buffer = make_buffer
        self._size_px = image_size_px
        self._pixel_format = pixel_format  # None: Mono8
        self._control_lost = control_lost
        self._is_stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, sink: EventSink) -> None:
        """Drop the frames of an earlier acquisition, then deliver to `sink`.

        The camera counts its frames from 1 again. Aravis' receive thread would drop those as late frames of the
        earlier acquisition, so a new thread is started.
        """
        self._stream.stop_thread(False)
        while (stale := self._stream.try_pop_buffer()) is not None:
            self._stream.push_buffer(stale)
        self._stream.start_thread()
        self._is_stopping.clear()
        self._thread = threading.Thread(
            target=self._run, args=(sink,), name=f"frames of {self._camera}", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """End the thread; idempotent."""
        self._is_stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _run(self, sink: EventSink) -> None:
        is_told = False
        while not self._is_stopping.is_set():
            buffer = self._stream.timeout_pop_buffer(POP_US)
            if buffer is not None:
                event = self._event(buffer)
                if isinstance(event, Frame):
                    if (empty := self._make_buffer()) is None:
                        event = self._lost("no memory: earlier images are still held", buffer)
                    else:
                        del self._memory[hash(buffer)]  # now the image of the frame
                        buffer = empty
                self._stream.push_buffer(buffer)
                if not self._is_stopping.is_set():
                    sink.deliver(event)
            elif self._control_lost.is_set() and not is_told:
                is_told = True
                sink.deliver(
                    CameraLost(
                        camera=self._camera,
                        received_ns=time.monotonic_ns(),
                        reason="control was lost",
                        cause=LossCause.CONTROL_LOST,
                    )
                )

    def _event(self, buffer: Any) -> Frame | FrameLost:
        status = buffer.get_status().value_nick
        if status != "success":
            return self._lost(status, buffer)
        image = self._image(buffer)
        if isinstance(image, str):
            return self._lost(image, buffer)
        return Frame(
            camera=self._camera,
            image=image,
            frame_id=buffer.get_frame_id(),
            device_ns=buffer.get_timestamp(),
            received_ns=_monotonic_ns(buffer.get_system_timestamp()),
        )

    def _image(self, buffer: Any) -> Image | str:
        """Return the buffer's pixels (H, W), without the chunks behind them, or what is wrong with them."""
        width_px, height_px = self._size_px
        if buffer.get_n_parts() == 0 and buffer.has_chunks():
            return CHUNKS
        if buffer.get_n_parts() != 1:
            return f"{buffer.get_n_parts()} images in a frame"
        got_px = (buffer.get_image_width(), buffer.get_image_height())
        if got_px != self._size_px:
            return f"wrong size: {got_px[0]} x {got_px[1]}, not {width_px} x {height_px}"
        data, n_pixels = self._memory[hash(buffer)], height_px * width_px
        pixels = data[:n_pixels]
        if self._pixel_format is not None:
            pixels[:] = self._pixel_format.grey(data, n_pixels)  # in the same memory, which the daemon maps
        return pixels.reshape(height_px, width_px)

    def _lost(self, reason: str, buffer: Any) -> FrameLost:
        """Return the loss, at the time of the frame's leader: Aravis reports it only after its own time-outs."""
        received_ns, now_ns = _monotonic_ns(buffer.get_system_timestamp()), time.monotonic_ns()
        if now_ns - received_ns > LATEST_LOSS_NS:  # no leader came: the time is of the buffer's previous use
            received_ns = now_ns
        return FrameLost(camera=self._camera, received_ns=received_ns, reason=reason)


def _monotonic_ns(wall_ns: int) -> int:
    """Return the time of the monotonic clock at `wall_ns`, a recent time of the wall clock.

    If that was set in between the answer is now, a few ms too late.
    """
    now_ns, age_ns = time.monotonic_ns(), time.time_ns() - wall_ns
    return now_ns - (age_ns if 0 <= age_ns <= OLDEST_NS else 0)
