"""A GigE Vision camera through Aravis.

Control calls to a camera that is gone take 2.5 s to fail, and closing it takes 8 s. So `gvcp.probe` asks first
whether it is there; calls that may block all the same hold this camera's lock and no other.
"""

import math
import threading
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from typing import Any

from drivers import gvcp
from drivers.cameras.aravis_library import aravis_errors, cleared_tracebacks, load_aravis
from drivers.cameras.bootstrap import BootstrapRegisters
from drivers.cameras.feature_access import AppliedFeature, FeatureAccess
from drivers.cameras.finding import find_camera
from drivers.cameras.frame_reader import Allocate, FrameReader, Memory, allocate, new_buffer
from drivers.cameras.genicam import GigeCameraSettings, all_features
from drivers.cameras.lamp import Lamp, give_strobe_back, strobe_off
from drivers.cameras.offers import as_offered, put_back
from drivers.cameras.pixel_formats import CONVERTED, PixelFormat
from drivers.cameras.stream_filter import max_packet_number, stream_program
from drivers.cameras.stream_socket import prepare_socket
from drivers.errors import CameraUnavailableError, DeviceFault, LossCause, Told, told
from drivers.interfaces import CameraVitals, EventSink
from pipeline.frames import CameraId

FULL_LINK_MBIT_S = 1000
FRAME_RETENTION_US = 250_000
"""A frame is given up after so long without a packet; Aravis' default of 0.1 s is too short on a busy machine."""
POLLED_FEATURES = ("DeviceTemperature", "PtpEnable", "PtpDataSetLatch", "PtpStatus", "PtpOffsetFromMaster")
"""Features that `examine` reports where the camera has them."""


class AravisCamera:
    """A GigE camera, found by serial number, address or user name; its settings are read back when it is examined.

    `allocate` has memory for all its buffers whenever it is opened. Where it was found the `last` time it is looked
    for first.
    """

    def __init__(
        self,
        settings: GigeCameraSettings,
        allocate: Allocate = allocate,
        last: gvcp.DiscoveredCamera | None = None,
    ) -> None:
        self._settings = settings
        self._allocate = allocate
        self._control = threading.RLock()
        self._device = last
        self._camera: Any = None  # the only lasting reference to Aravis' object, see `cleared_tracebacks`
        self._stream: Any = None
        self._reader: FrameReader | None = None
        self._memory: Memory = {}
        self._control_lost = threading.Event()
        self._control_lost_signal = 0
        self._applied: list[AppliedFeature] = []
        self._polled: dict[str, str] = {}
        self._lamp: Lamp | None = None  # while a person is shown the camera
        self._receive_buffer_bytes = 0
        self._warnings: tuple[Told, ...] = ()
        self._remarks: tuple[Told, ...] = ()
        self._pixel_format: PixelFormat | None = None  # None: Mono8
        self._is_acquiring = False

    @property
    def id(self) -> CameraId:
        return self._settings.id

    @property
    def found(self) -> gvcp.DiscoveredCamera | None:
        """The camera as it was found the last time."""
        return self._device

    def open(self) -> None:
        """Find the camera, take control, write all settings and read them back, prepare the stream.

        An open camera is closed first.

        Raises
        ------
        CameraUnavailableError
            It does not answer, is another one, is in use, or cannot be set as configured.
        """
        with self._control:
            self.close()
            try:
                with cleared_tracebacks(), aravis_errors(self.id, "be opened"):
                    self._device = find_camera(self._settings, self._device)
                    self._connect(self._device.address)
                    self._configure()
                    self._prepare_stream(self._device.address)
            except CameraUnavailableError:
                self.close()
                raise

    def arm(self, sink: EventSink) -> None:
        with self._control:
            self.disarm()
            if self._reader is None:
                raise CameraUnavailableError(self.id, "is not open")
            self._give_lamp_back()
            self._reader.start(sink)
            self._is_acquiring = True
            try:
                with cleared_tracebacks(), aravis_errors(self.id, "start the acquisition"):
                    self._camera.start_acquisition()
            except CameraUnavailableError:
                self.disarm()
                raise

    def examine(self) -> CameraVitals:
        """Read the camera's vital signs; takes 0.3 s at most, unless it dies between the requests."""
        device = self._device
        if self._camera is None or device is None:
            raise CameraUnavailableError(self.id, "is not open")
        seen = gvcp.probe(device.address)
        if seen is None:
            raise CameraUnavailableError(self.id, f"does not answer at {device.address}", LossCause.SILENT)
        if seen.serial != device.serial:
            problem = f"another camera, serial {seen.serial}, has the address {device.address}"
            raise CameraUnavailableError(self.id, problem, LossCause.WRONG_CAMERA)
        with self._control, cleared_tracebacks(), aravis_errors(self.id, "be examined"):
            is_lost = self._control_lost.is_set()
            self._registers().require_control(self._stream.get_port(), is_known_lost=is_lost)
            self._features().verify(self._applied)
            return self._vitals(device)

    def light(self, *, is_on: bool) -> None:
        with self._control, cleared_tracebacks(), aravis_errors(self.id, "switch its lamp"):
            if self._reader is None:
                raise CameraUnavailableError(self.id, "is not open")
            if self._is_acquiring:
                raise CameraUnavailableError(self.id, "is armed")
            if self._lamp is None:
                self._lamp = Lamp(self._features(), self.id, self._settings.features)
            self._lamp.switch(is_on=is_on)

    def software_trigger(self) -> None:
        """Expose now, if `TriggerSource` is `Software`; raises `CameraUnavailableError`."""
        with self._control, cleared_tracebacks():
            if self._camera is None:
                raise CameraUnavailableError(self.id, "is not open")
            with aravis_errors(self.id, "trigger by software"):
                self._camera.software_trigger()

    def disarm(self) -> None:
        with self._control:
            if self._reader is not None:
                self._reader.stop()
            if self._is_acquiring:
                self._is_acquiring = False
                if self._is_there():
                    with suppress(CameraUnavailableError), aravis_errors(self.id, "stop the acquisition"):
                        self._camera.stop_acquisition()

    def close(self) -> None:
        """Give up control of the camera; when it is gone this takes up to 8 s, in Aravis and without the GIL."""
        with self._control:
            self.disarm()
            if self._camera is not None:
                if self._is_there():
                    with suppress(CameraUnavailableError):
                        self._give_lamp_back()
                    if self._settings.is_strobe_off:
                        with suppress(CameraUnavailableError), cleared_tracebacks():
                            give_strobe_back(self._features(), self._settings.features)
                    with suppress(CameraUnavailableError), aravis_errors(self.id, "give up control"):
                        self._camera.get_device().leave_control()
                self._camera.get_device().disconnect(self._control_lost_signal)
            # first: it ends the thread of Aravis that receives into the memory
            self._reader = self._stream = None
            self._camera = None
            self._lamp = None
            self._memory = {}
            self._applied = []

    def _give_lamp_back(self) -> None:
        lamp, self._lamp = self._lamp, None
        if lamp is not None:
            with cleared_tracebacks(), aravis_errors(self.id, "switch its lamp"):
                lamp.give_back()

    # --- opening ---

    def _connect(self, address: str) -> None:
        aravis = load_aravis(self.id)
        with aravis_errors(self.id, f"open {address}"):
            self._camera = aravis.Camera.new(address)
        self._control_lost = control_lost = threading.Event()
        # Called by Aravis' heartbeat. It refers to the event alone: with `self` it would keep the camera for ever.
        self._control_lost_signal = self._camera.get_device().connect(
            "control-lost", lambda *_: control_lost.set()
        )
        self._registers().require_controller(address)

    def _configure(self) -> None:
        """Stop the camera, which may have been left running, then write all settings and read them back."""
        settings, features = self._settings, self._features()
        with aravis_errors(self.id, "stop the acquisition"):
            self._camera.stop_acquisition()
        with aravis_errors(self.id, "switch the triggers off"):
            # a trigger left on for AcquisitionStart or FrameBurstStart would be waited for without end
            self._camera.clear_triggers()
        ticks_per_s = self._camera.get_device().get_timestamp_tick_frequency()
        delay_ticks = math.ceil(settings.packet_delay_ns * ticks_per_s / 1e9)
        packets = [("GevSCPD", delay_ticks)]
        if settings.packet_size_bytes is not None:
            packets.append(("GevSCPSPacketSize", settings.packet_size_bytes))
        wanted = [*all_features(settings), *packets]
        configured = strobe_off(features, wanted) if settings.is_strobe_off else wanted
        held, remarks = put_back(features, configured)
        remarks += self._registers().put_heartbeat_back(configured)
        self._applied = [*held, *features.apply(as_offered(features, configured, remarks))]
        features.verify(self._applied)  # a later setting may have changed an earlier one
        self._remarks = tuple(remarks)
        self._pixel_format = CONVERTED.get(str(features.read("PixelFormat")))
        self._polled = {}
        for name in POLLED_FEATURES:
            if own := features.own_name(name):
                self._polled[name] = own

    def _prepare_stream(self, address: str) -> None:
        settings, aravis = self._settings, load_aravis(self.id)
        adjustment = aravis.GvPacketSizeAdjustment
        self._camera.gv_set_packet_size_adjustment(
            adjustment.ALWAYS if settings.packet_size_bytes is None else adjustment.ON_FAILURE
        )
        self._camera.gv_set_stream_options(aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
        with aravis_errors(self.id, "create the stream"):
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
            self._applied.append(AppliedFeature(name="GevSCPSPacketSize", value=packet_bytes))
        self._stream.set_property("packet-resend", aravis.GvStreamPacketResend.ALWAYS)
        self._stream.set_property("frame-retention", FRAME_RETENTION_US)
        # not set by Aravis, which would do so only after the first packet
        self._stream.set_property("socket-buffer", aravis.GvStreamSocketBuffer.FIXED)
        self._stream.set_property("socket-buffer-size", 0)
        host = self._camera.get_device().get_interface_address().get_address().to_string()
        local = (host, self._stream.get_port())
        program = stream_program(address, max_packet_number(payload_bytes, packet_bytes))
        try:
            self._receive_buffer_bytes = prepare_socket(local, settings.receive_buffer_bytes, program)
        except (LookupError, OSError) as err:
            raise CameraUnavailableError(self.id, f"cannot prepare its stream's socket: {err}") from err
        self._warnings = tuple(self._opening_warnings())
        make_buffer = partial(new_buffer, aravis, payload_bytes, self._memory, self._allocate)
        for _ in range(settings.n_buffers):
            self._stream.push_buffer(make_buffer())
        self._reader = FrameReader(
            self.id,
            self._stream,
            memory=self._memory,
            make_buffer=make_buffer,
            image_size_px=settings.image_size_px,
            pixel_format=self._pixel_format,
            control_lost=self._control_lost,
        )

    def _opening_warnings(self) -> Iterator[Told]:
        """Yield each thing that works but needs attention, with the remedy."""
        wanted = self._settings.receive_buffer_bytes
        if self._receive_buffer_bytes < wanted:
            yield told(
                DeviceFault.RECEIVE_BUFFER_SMALL,
                granted_bytes=self._receive_buffer_bytes,
                wanted_bytes=wanted,
            )
        with suppress(CameraUnavailableError):  # cameras from before GigE Vision 1.1 do not say
            if 0 < (mbit_s := self._registers().link_mbit_s()) < FULL_LINK_MBIT_S:
                yield told(DeviceFault.LINK_SLOW, link_mbit_s=mbit_s)

    # --- watching ---

    def _vitals(self, device: gvcp.DiscoveredCamera) -> CameraVitals:
        polled, warnings, ptp_status, ptp_offset_ns = self._poll(), list(self._warnings), None, None
        if polled.get("PtpEnable"):
            ptp_offset_ns = polled.get("PtpOffsetFromMaster")
            ptp_status = polled.get("PtpStatus", "Slave")
            if ptp_status not in ("Slave", "Master"):  # whether it may be the master only the rig knows
                warnings.append(told(DeviceFault.CLOCK_WITHOUT_MASTER, status=ptp_status))
        return CameraVitals(
            serial=device.serial,
            model=device.model,
            address=device.address,
            temperature_c=polled.get("DeviceTemperature"),
            ptp_status=ptp_status,
            ptp_offset_ns=ptp_offset_ns,
            receive_buffer_bytes=self._receive_buffer_bytes,
            frames=self._counter("n_completed_buffers"),
            failed_frames=self._counter("n_failures"),
            missing_packets=self._counter("n_missing_packets"),
            resent_packets=self._counter("n_resent_packets"),
            warnings=tuple(warnings),
            remarks=self._remarks,
        )

    def _poll(self) -> dict[str, Any]:
        """Return the present values by SFNC name; the PTP latch, a command, is executed before its offset is read."""
        features, polled = self._features(), {}
        for name, own in self._polled.items():
            if name == "PtpDataSetLatch":
                features.execute(own)
            else:
                polled[name] = features.read(own)
        return polled

    def _is_there(self) -> bool:
        device = self._device
        return device is not None and gvcp.probe(device.address) is not None

    def _counter(self, name: str) -> int:
        return int(self._stream.get_info_uint64_by_name(name))

    def _features(self) -> FeatureAccess:
        return FeatureAccess(load_aravis(self.id), self.id, self._camera.get_device())

    def _registers(self) -> BootstrapRegisters:
        return BootstrapRegisters(self.id, self._camera.get_device())
