"""Aravis as it is, without our driver: what the simulated camera must please."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Self

import gi
import numpy as np
from numpy.typing import NDArray

gi.require_version("Aravis", "0.8")
from gi.repository import Aravis, GLib  # noqa: E402 - only after its version is chosen

AravisError = GLib.Error

__all__ = ["AravisError", "AravisStream", "opened"]


@contextmanager
def opened(address: str) -> Iterator[Any]:
    """Open an `Aravis.Camera`; give up control at the end."""
    Aravis.disable_interface("USB3Vision")
    camera = Aravis.Camera.new(address)
    try:
        yield camera
    finally:
        if camera.get_device().is_controller():
            camera.get_device().leave_control()


class AravisStream:
    """A stream with eight buffers that acquires while it is open."""

    def __init__(self, camera: Any, *, resend_ratio: float | None = None) -> None:
        camera.gv_set_stream_options(Aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
        self.camera = camera
        self.stream = camera.create_stream(None, None)
        self.stream.set_property("socket-buffer", Aravis.GvStreamSocketBuffer.FIXED)
        self.stream.set_property("socket-buffer-size", 1 << 20)
        self.stream.set_property("frame-retention", 1_000_000)  # us: on a busy machine resends come late
        if resend_ratio is not None:
            self.stream.set_property("packet-request-ratio", resend_ratio)
        self.payload_bytes = camera.get_payload()
        for _ in range(8):
            self.stream.push_buffer(Aravis.Buffer.new_allocate(self.payload_bytes))
        camera.start_acquisition()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.camera.get_device().is_controller():
            self.camera.stop_acquisition()
        self.stream = None

    def pop(self, timeout_s: float = 5.0) -> tuple[str, int, NDArray[np.uint8]] | None:
        """Status, frame id and image of the next buffer; nothing when there is none in time."""
        buffer = self.stream.timeout_pop_buffer(round(timeout_s * 1e6))
        if buffer is None:
            return None
        image = np.empty((0, 0), np.uint8)
        status = buffer.get_status().value_nick
        if status == "success":
            width, height = buffer.get_image_width(), buffer.get_image_height()
            data = np.frombuffer(buffer.get_data(), np.uint8)
            image = data[: width * height].reshape(height, width).copy()
        frame_id = buffer.get_frame_id()
        self.stream.push_buffer(buffer)
        return status, frame_id, image

    def pop_chunks(self, *names: str) -> dict[str, int]:
        """Integer chunks of the next buffer."""
        buffer = self.stream.timeout_pop_buffer(5_000_000)
        parser = self.camera.create_chunk_parser()
        values = {name: parser.get_integer_value(buffer, name) for name in names}
        self.stream.push_buffer(buffer)
        return values

    def statistics(self) -> dict[str, int]:
        return {
            self.stream.get_info_name(index): self.stream.get_info_uint64(index)
            for index in range(self.stream.get_n_infos())
        }
