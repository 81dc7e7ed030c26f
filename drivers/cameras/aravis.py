"""A GigE Vision camera through Aravis.

Control calls to a camera that is gone take 2.5 s to fail and closing it 8 s, so a datagram of our own asks
first whether it is there; what may block all the same holds this camera's lock and no other.
"""

import math
import threading
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from typing import Any

from drivers import gvcp
from drivers.cameras.aravis_library import explained, forgetful, load_aravis
from drivers.cameras.feature_access import Applied, FeatureAccess
from drivers.cameras.finding import find_camera
from drivers.cameras.frame_reader import FrameReader, Memory, new_buffer
from drivers.cameras.genicam import GigeCameraSettings, all_features
from drivers.cameras.stream_socket import widen_receive_buffer
from drivers.errors import CameraUnavailableError, LossCause
from drivers.interfaces import CameraVitals, EventSink
from pipeline.frames import CameraId

PROBE_S = 0.25
"""How long a camera may take to say that it is there."""
FULL_LINK_MBIT_S = 1000
FRAME_RETENTION_US = 250_000
"""Without a packet for so long a frame is given up: on a busy machine 0.1 s, as Aravis has it, is soon over."""
POLLED = ("DeviceTemperature", "PtpEnable", "PtpDataSetLatch", "PtpStatus", "PtpOffsetFromMaster")
"""Features `examine` reports, of those a camera has."""

_LINK_SPEED, _HEARTBEAT_MS, _CONTROL_PRIVILEGE, _STREAM_PORT = 0x670, 0x938, 0xA00, 0xD00
"""Bootstrap registers, the same in every camera: in Mbit/s; in ms; 0 when nobody has control; 0 for no stream."""
_CONTROL = 0x2
"""Control privilege: ours to write, others may read."""


class AravisCamera:
    """One GigE camera: found by serial number, address or user name, set and read back, watched by `examine`."""

    def __init__(self, settings: GigeCameraSettings) -> None:
        self._settings = settings
        self._control = threading.RLock()
        self._device: gvcp.DiscoveredCamera | None = None  # as it was found the last time
        self._camera: Any = None  # nothing else may refer to Aravis' objects for long, see forgetful
        self._stream: Any = None
        self._reader: FrameReader | None = None
        self._memory: Memory = {}
        self._control_lost = threading.Event()
        self._control_lost_signal = 0
        self._applied: list[Applied] = []
        self._polled: dict[str, str] = {}
        self._receive_buffer_bytes = 0
        self._warnings: tuple[str, ...] = ()
        self._is_acquiring = False

    @property
    def id(self) -> CameraId:
        return self._settings.id

    def open(self) -> None:
        """Find the camera, take control, write all settings and read them back, prepare the stream.

        Raises `CameraUnavailableError` when it is not there, another one, in use, or unable to do what is configured.
        """
        with self._control:
            self.close()
            try:
                with forgetful(), explained(self.id, "be opened"):
                    self._device = find_camera(self._settings, self._device)
                    self._connect(self._device.address)
                    self._configure()
                    self._prepare_stream()
            except CameraUnavailableError:
                self.close()
                raise

    def arm(self, sink: EventSink) -> None:
        with self._control:
            self.disarm()
            if self._reader is None:
                raise CameraUnavailableError(self.id, "is not open")
            self._reader.start(sink)
            self._is_acquiring = True
            try:
                with forgetful(), explained(self.id, "start the acquisition"):
                    self._camera.start_acquisition()
            except CameraUnavailableError:
                self.disarm()
                raise

    def examine(self) -> CameraVitals:
        """Ask within 0.3 s, unless the camera dies right between the questions."""
        device = self._device
        if self._camera is None or device is None:
            raise CameraUnavailableError(self.id, "is not open")
        seen = gvcp.probe(device.address, PROBE_S)
        if seen is None:
            raise CameraUnavailableError(self.id, f"does not answer at {device.address}", LossCause.SILENT)
        if seen.serial != device.serial:
            problem = f"another camera, serial {seen.serial}, has the address {device.address}"
            raise CameraUnavailableError(self.id, problem, LossCause.WRONG_CAMERA)
        with self._control, forgetful(), explained(self.id, "be examined"):
            self._require_control()
            self._features().verify(self._applied)
            return self._vitals(device)

    def software_trigger(self) -> None:
        """Expose now, if `TriggerSource` is `Software`."""
        with self._control, forgetful():
            if self._camera is None:
                raise CameraUnavailableError(self.id, "is not open")
            with explained(self.id, "trigger by software"):
                self._camera.software_trigger()

    def disarm(self) -> None:
        with self._control:
            if self._reader is not None:
                self._reader.stop()
            if self._is_acquiring:
                self._is_acquiring = False
                if self._is_there():
                    with suppress(CameraUnavailableError), explained(self.id, "stop the acquisition"):
                        self._camera.stop_acquisition()

    def close(self) -> None:
        """Leave the camera to others; when it is gone this takes up to 8 s, in Aravis and without the GIL."""
        with self._control:
            self.disarm()
            if self._camera is not None:
                if self._is_there():
                    with suppress(CameraUnavailableError), explained(self.id, "give up control"):
                        self._camera.get_device().leave_control()
                self._camera.get_device().disconnect(self._control_lost_signal)
            self._reader = self._stream = None  # first: this ends the thread that receives into the memory
            self._camera = None
            self._memory = {}
            self._applied = []

    # --- opening ---

    def _connect(self, address: str) -> None:
        aravis = load_aravis(self.id)
        with explained(self.id, f"open {address}"):
            self._camera = aravis.Camera.new(address)
        self._control_lost = control_lost = threading.Event()
        # the event, not self: a callback that leads back to the camera keeps it for ever. Comes from Aravis' heartbeat.
        self._control_lost_signal = self._camera.get_device().connect(
            "control-lost", lambda *_: control_lost.set()
        )
        if not self._camera.get_device().is_controller():
            heartbeat_s = self._register(_HEARTBEAT_MS) / 1e3
            raise CameraUnavailableError(
                self.id,
                f"is in use by another application at {address}; if it was a predecessor of this one, "
                f"killed, its heartbeat ends within {heartbeat_s:g} s",
                LossCause.IN_USE,
            )

    def _configure(self) -> None:
        """Set a camera that stands still: whoever had it before may have left it running."""
        settings, features = self._settings, self._features()
        with explained(self.id, "stop the acquisition"):
            self._camera.stop_acquisition()
        with explained(self.id, "switch the triggers off"):
            self._camera.clear_triggers()  # AcquisitionStart or FrameBurstStart, left on, waits for ever
        ticks_per_s = self._camera.get_device().get_timestamp_tick_frequency()
        delay_ticks = math.ceil(settings.packet_delay_ns * ticks_per_s / 1e9)
        packets = [("GevSCPD", delay_ticks)]
        if settings.packet_size_bytes is not None:
            packets.append(("GevSCPSPacketSize", settings.packet_size_bytes))
        self._applied = features.apply([*all_features(settings), *packets])
        features.verify(self._applied)  # a later setting may have changed an earlier one
        self._polled = {}
        for name in POLLED:
            if own := features.own_name(name):
                self._polled[name] = own

    def _prepare_stream(self) -> None:
        settings, aravis = self._settings, load_aravis(self.id)
        adjustment = aravis.GvPacketSizeAdjustment
        self._camera.gv_set_packet_size_adjustment(
            adjustment.ALWAYS if settings.packet_size_bytes is None else adjustment.ON_FAILURE
        )
        self._camera.gv_set_stream_options(aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
        with explained(self.id, "create the stream"):
            self._stream = self._camera.create_stream(None, None)
            packet_bytes = self._camera.gv_get_packet_size()
            payload_bytes = self._camera.get_payload()
        wanted = settings.packet_size_bytes or packet_bytes
        if packet_bytes != wanted:
            raise CameraUnavailableError(
                self.id,
                f"packets of {wanted} bytes do not get through, {packet_bytes} do: set the MTU of the network "
                f"port and of the switch to {wanted} or more, or packet_size_bytes to {packet_bytes}",
                LossCause.WRONG_SETTINGS,
            )
        if settings.packet_size_bytes is None:
            self._applied.append(Applied(name="GevSCPSPacketSize", value=packet_bytes))
        self._stream.set_property("packet-resend", aravis.GvStreamPacketResend.ALWAYS)
        self._stream.set_property("frame-retention", FRAME_RETENTION_US)
        # fixed, and not set by Aravis, which would do so only when the first packet is in
        self._stream.set_property("socket-buffer", aravis.GvStreamSocketBuffer.FIXED)
        self._stream.set_property("socket-buffer-size", 0)
        host = self._camera.get_device().get_interface_address().get_address().to_string()
        local = (host, self._stream.get_port())
        try:
            self._receive_buffer_bytes = widen_receive_buffer(local, settings.receive_buffer_bytes)
        except (LookupError, OSError) as err:
            raise CameraUnavailableError(self.id, f"cannot widen its receive buffer: {err}") from err
        self._warnings = tuple(self._opening_warnings())
        another_buffer = partial(new_buffer, aravis, payload_bytes, self._memory)
        for _ in range(settings.n_buffers):
            self._stream.push_buffer(another_buffer())
        self._reader = FrameReader(
            self.id,
            self._stream,
            memory=self._memory,
            another_buffer=another_buffer,
            image_size_px=settings.image_size_px,
            control_lost=self._control_lost,
        )

    def _opening_warnings(self) -> Iterator[str]:
        wanted = self._settings.receive_buffer_bytes
        if self._receive_buffer_bytes < wanted:
            yield (
                f"the kernel granted {self._receive_buffer_bytes} of {wanted} bytes to receive into: "
                f"sysctl -w net.core.rmem_max={wanted}"
            )
        with suppress(CameraUnavailableError):  # cameras from before GigE Vision 1.1 do not say
            if 0 < (mbit_s := self._register(_LINK_SPEED)) < FULL_LINK_MBIT_S:
                yield f"its link runs at {mbit_s} Mbit/s: check the cable and the port of the switch"

    # --- watching ---

    def _require_control(self) -> None:
        """Raise when the camera forgot us, by switching off and on, or obeys another application."""
        is_known = not self._control_lost.is_set() and self._register(_CONTROL_PRIVILEGE) != 0
        if not is_known or self._register(_STREAM_PORT) & 0xFFFF != self._stream.get_port():
            raise CameraUnavailableError(
                self.id,
                "control was lost: the camera was restarted, or let us go",
                LossCause.CONTROL_LOST,
            )
        try:
            with explained(self.id, "keep it"):  # whoever has control may say so again, nobody else
                self._camera.get_device().write_register(_CONTROL_PRIVILEGE, _CONTROL)
        except CameraUnavailableError as err:
            problem = f"control was lost: {err.problem}"
            raise CameraUnavailableError(self.id, problem, LossCause.CONTROL_LOST) from err

    def _vitals(self, device: gvcp.DiscoveredCamera) -> CameraVitals:
        polled, warnings, ptp_offset_ns = self._poll(), list(self._warnings), None
        if polled.get("PtpEnable"):
            ptp_offset_ns = polled.get("PtpOffsetFromMaster")
            if (status := polled.get("PtpStatus", "Slave")) != "Slave":
                warnings.append(f"its clock follows no PTP master (status {status}): is one running?")
        return CameraVitals(
            serial=device.serial,
            model=device.model,
            address=device.address,
            temperature_c=polled.get("DeviceTemperature"),
            ptp_offset_ns=ptp_offset_ns,
            receive_buffer_bytes=self._receive_buffer_bytes,
            frames=self._counter("n_completed_buffers"),
            failed_frames=self._counter("n_failures"),
            missing_packets=self._counter("n_missing_packets"),
            resent_packets=self._counter("n_resent_packets"),
            warnings=tuple(warnings),
        )

    def _poll(self) -> dict[str, Any]:
        """Values now, by SFNC name; commands are given, as the latch must be before the offset is read."""
        features, polled = self._features(), {}
        for name, own in self._polled.items():
            if name == "PtpDataSetLatch":
                features.execute(own)
            else:
                polled[name] = features.read(own)
        return polled

    def _is_there(self) -> bool:
        device = self._device
        return device is not None and gvcp.probe(device.address, PROBE_S) is not None

    def _register(self, address: int) -> int:
        with explained(self.id, f"read register 0x{address:x}"):
            return int(self._camera.get_device().read_register(address))

    def _counter(self, name: str) -> int:
        return int(self._stream.get_info_uint64_by_name(name))

    def _features(self) -> FeatureAccess:
        return FeatureAccess(load_aravis(self.id), self.id, self._camera.get_device())
