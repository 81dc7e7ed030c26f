"""The thread that takes a camera's frames from Aravis and delivers them, without a copy.

Pulled, never pushed: a callback or signal would run in Aravis' receive thread and cost packets. The
memory that a frame was received into is its image, and Aravis gets a buffer with other memory at once.
Every other status than success means there is no image.
"""

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.errors import LossCause
from drivers.interfaces import CameraLost, EventSink, FrameLost
from pipeline.frames import CameraId, Frame, Image

POP_US = 50_000
"""How long one wait for a frame lasts, and so how long `stop` may take."""
Memory = dict[int, NDArray[np.uint8]]
"""What the buffers that Aravis has receive into, by a buffer's hash, which is its address."""
LATEST_LOSS_NS = 500_000_000
"""A frame that is not whole by then is given up."""
OLDEST_NS = 1_000_000_000
"""A frame is not older than this: else the wall clock was set between its leader and now."""


def new_buffer(aravis: Any, n_bytes: int, memory: Memory) -> Any:
    """An `aravis.Buffer` of so many bytes that receives into an array of ours, entered into `memory`."""
    pixels = np.empty(n_bytes, np.uint8)
    buffer = aravis.Buffer.new(n_bytes, pixels.ctypes.data)
    memory[hash(buffer)] = pixels
    return buffer


class FrameReader:
    """Reads one stream from `start` to `stop`; after `stop` returned nothing more is delivered."""

    def __init__(
        self,
        camera: CameraId,
        stream: Any,
        *,
        memory: Memory,
        another_buffer: Callable[[], Any],
        image_size_px: tuple[int, int],
        control_lost: threading.Event,
    ) -> None:
        self._camera = camera
        self._stream = stream
        self._memory = memory
        self._another_buffer = another_buffer
        self._size_px = image_size_px
        self._control_lost = control_lost
        self._is_stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, sink: EventSink) -> None:
        """Forget what is left from before, then deliver.

        The camera will count its frames from 1 again, which Aravis' receive thread would throw away as late
        ones of before: only a new thread has no before.
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
                    del self._memory[hash(buffer)]  # it is the frame's now
                    buffer = self._another_buffer()
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
        """The buffer's pixels, without the chunks behind them; or what is wrong with the picture."""
        width_px, height_px = self._size_px
        if buffer.get_n_parts() != 1:
            return f"{buffer.get_n_parts()} images in a frame"
        got_px = (buffer.get_image_width(), buffer.get_image_height())
        if got_px != self._size_px:
            return f"wrong size: {got_px[0]} x {got_px[1]}, not {width_px} x {height_px}"
        pixels = self._memory[hash(buffer)][: height_px * width_px]
        return pixels.reshape(height_px, width_px)

    def _lost(self, reason: str, buffer: Any) -> FrameLost:
        """A loss is told when Aravis has waited long enough, but belongs to the moment of its leader."""
        received_ns, now_ns = _monotonic_ns(buffer.get_system_timestamp()), time.monotonic_ns()
        if now_ns - received_ns > LATEST_LOSS_NS:  # without a leader there is still the buffer's last one
            received_ns = now_ns
        return FrameLost(camera=self._camera, received_ns=received_ns, reason=reason)


def _monotonic_ns(wall_ns: int) -> int:
    """When it was on the monotonic clock, at the wall clock's recent time `wall_ns`."""
    now_ns = time.monotonic_ns()
    return now_ns - min(max(time.time_ns() - wall_ns, 0), OLDEST_NS)
