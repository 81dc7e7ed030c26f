"""A simulated GigE Vision camera: real packets from an address of its own, without root rights or hardware.

A camera has two threads: that of its GVCP port answers commands, that of its sensor exposes and sends. Any address
of 127/8 works without being configured; broadcast discovery finds all cameras of a machine.
"""

import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from typing import Literal

from drivers.errors import CameraUnavailableError
from drivers.gige_simulator.clock import CameraClock
from drivers.gige_simulator.counters import Counters
from drivers.gige_simulator.design import CameraDesign
from drivers.gige_simulator.device import CameraDevice, make_registers
from drivers.gige_simulator.faults import Faults
from drivers.gige_simulator.features import Feature
from drivers.gige_simulator.gvcp_channel import GvcpChannel, Peer
from drivers.gige_simulator.gvcp_port import GvcpPort
from drivers.gige_simulator.imaging import Exposure, ImageSource, Imaging
from drivers.gige_simulator.registers import Value
from drivers.gige_simulator.sensor import Sensor, Strobe
from drivers.gige_simulator.stream import StreamChannel
from drivers.gige_simulator.uplink import Uplink
from drivers.gvcp import GVCP_PORT
from pipeline.frames import CameraId

__all__ = ["CameraDesign", "Exposure", "ImageSource", "LogEntry", "SimulatedCamera", "Strobe"]

BOOT_S = 1.0
"""How long a `DeviceReset` takes."""

_N_LOGGED = 1000
_FOREVER_NS = 2**62


@dataclass(frozen=True, slots=True)
class LogEntry:
    """An event in the life of the camera: control, power, cable, settings."""

    at_ns: int  # host's monotonic clock
    event: str


class SimulatedCamera:
    """A camera between `start` and `stop`; thread-safe. Started again it has lost its settings."""

    def __init__(
        self,
        design: CameraDesign,
        source: ImageSource,
        *,
        on_strobe: Callable[[Strobe], None] | None = None,
        uplink: Uplink | None = None,
    ) -> None:
        self.faults = Faults()
        self._design = design
        self._lock = threading.RLock()
        self._log: deque[LogEntry] = deque(maxlen=_N_LOGGED)
        self._clock = CameraClock(
            offset_ns=design.clock_offset_ns, drift_ppm=design.clock_drift_ppm, seed=design.seed
        )
        self._registers = make_registers(design)
        self._stream = StreamChannel(
            self.faults, seed=design.seed, is_connected=self._is_connected, uplink=uplink
        )
        self._sensor = Sensor(
            design,
            registers=self._registers,
            clock=self._clock,
            stream=self._stream,
            faults=self.faults,
            imaging=Imaging(self._registers, faults=self.faults, source=source, note=self._note),
            on_strobe=on_strobe,
        )
        self._device = CameraDevice(
            registers=self._registers,
            sensor=self._sensor,
            stream=self._stream,
            clock=self._clock,
            faults=self.faults,
            note=self._note,
            restart=lambda: self._power_off(BOOT_S),
        )
        self._gvcp = GvcpChannel(self._registers, self._device)
        self._stream_port = 0
        self._unplugged_until_ns = 0
        self._off_until_ns: int | None = None
        self._port = GvcpPort(
            design.id,
            answer=self._answer,
            next_due_ns=self._next_due_ns,
            run_due=self._run_due,
            faults=self.faults,
            seed=design.seed,
        )

    # --- state ---

    @property
    def id(self) -> CameraId:
        return self._design.id

    @property
    def design(self) -> CameraDesign:
        """The present design: address and serial number may have changed by `power_cycle`."""
        return self._design

    @property
    def is_acquiring(self) -> bool:
        return self._registers.is_acquiring

    @property
    def stream_port(self) -> int:
        """UDP port that the frames are sent from."""
        return self._stream_port

    @property
    def controller(self) -> Peer | None:
        """Address and port of the application in control."""
        return self._gvcp.controller

    @property
    def is_lit(self) -> bool:
        """Whether its lamp shines: the status lamp, else what the strobe's line feeds."""
        return self._device.is_lit

    @property
    def log(self) -> tuple[LogEntry, ...]:
        return tuple(self._log)

    @property
    def counters(self) -> Counters:
        return Counters(
            **asdict(self._sensor.tallied()),
            **asdict(self._stream.tallied()),
            heartbeats=self._gvcp.n_heartbeats,
            actions=self._gvcp.n_actions,
            blinks=self._device.blinks,
        )

    @property
    def features(self) -> Mapping[str, Feature]:
        """All features, by SFNC name."""
        return self._registers.features

    def feature(self, name: str, bank: int = 0) -> Value:
        """Return the value of a feature, by its SFNC name in either dialect; of an enumeration the number."""
        return self._registers.get(name, bank)

    def address_of(self, name: str, bank: int = 0) -> int:
        """Return the address of a feature's register, by its SFNC name."""
        return self._registers.address(name, bank)

    # --- life ---

    def start(self) -> None:
        """Switch on; raises `CameraUnavailableError` when the address is taken or not this machine's."""
        address = self._design.address
        with self._lock, self._explained_bind(address):
            self._stream_port = self._stream.open(address)
            self._power_on()
            try:
                self._port.open(address)
            except OSError:
                self._stream.close()
                raise
        self._sensor.start()

    def stop(self) -> None:
        """Vanish as a killed process does: control is not given up, the kernel refuses further datagrams."""
        self._port.close()
        self._sensor.stop()
        self._stream.close()
        self._gvcp.reset()

    # --- signals ---

    def line(self, name: str | None = None, at_ns: int | None = None, *, rising: bool = True) -> None:
        """Apply an electrical edge to an input line, at `at_ns` of `time.monotonic_ns`; None: the first line, now."""
        name = name or self._design.ways.lines[0]
        self._sensor.line(name, time.monotonic_ns() if at_ns is None else at_ns, rising=rising)

    def skip_blocks(self, n_blocks: int) -> None:
        """Raise the block id of the next frame by `n_blocks`, as if so many more had been exposed."""
        self._sensor.skip_blocks(n_blocks)

    # --- faults that take time ---

    def unplug(self, seconds: float | None = None) -> None:
        """Pull the network cable, for `seconds` or until `replug`; the camera keeps its power and its settings."""
        with self._lock:
            ns = _FOREVER_NS if seconds is None else time.monotonic_ns() + round(seconds * 1e9)
            self._unplugged_until_ns = ns
            self._note("cable pulled")

    def replug(self) -> None:
        with self._lock:
            self._unplugged_until_ns = 0
            self._note("cable plugged in")

    def power_cycle(
        self, off_s: float = 2.0, *, address: str | None = None, serial: str | None = None
    ) -> None:
        """Cut the power for `off_s`; afterwards the camera has lost its settings and its controller.

        With `address` it comes back at another one (a new DHCP lease), with `serial` another device is in its place.
        Raises `CameraUnavailableError` when that address is taken.
        """
        with self._lock:
            design = self._design
            if address is not None and self._port.is_open:
                with self._explained_bind(address):
                    self._port.move(address)
                    self._stream_port = self._stream.open(address)
            self._design = replace(design, address=address or design.address, serial=serial or design.serial)
            self._power_off(off_s)
        self._port.wake()

    def steal_control(self, seconds: float = 5.0, peer: Peer = ("192.0.2.66", 49152)) -> None:
        """Give control to another application for `seconds`; then its heartbeat ends."""
        with self._lock:
            timeout_ns = self._registers.number("GevHeartbeatTimeout") * 1_000_000
            self._gvcp.seize(peer, heard_ns=time.monotonic_ns() + round(seconds * 1e9) - timeout_ns)
        self._port.wake()

    def tamper(self, name: str, value: Value, bank: int = 0) -> None:
        """Change a feature without its controller; by SFNC name, an enumeration by number or entry.

        Raises `ValueError` for a feature, bank or entry that does not exist, and for a value of another type.
        """
        feature = self._registers.features.get(name)
        if feature is None or not 0 <= bank < self._registers.n_banks(feature):
            raise ValueError(f"camera {self.id} has no feature {name!r}, bank {bank}")
        if feature.kind == "enumeration" and isinstance(value, str):
            if value not in feature.entries:
                raise ValueError(f"camera {self.id}: {name} has no entry {value!r}")
            value = feature.entries[value]
        if isinstance(value, str) != (feature.kind == "string"):
            raise ValueError(f"camera {self.id}: {name} cannot be set to a {type(value).__name__}")
        with self._lock:
            self._registers.put(name, value, bank)
            self._device.written((name, bank))
            self._note(f"{name} changed to {value} by a foreign hand")

    def jump_clock(self, by_ns: int) -> None:
        """Let the camera's clock jump."""
        with self._lock:
            self._clock.jump(by_ns)
            self._note(f"clock jumped by {by_ns} ns")

    def send_malformed(self, kind: Literal["short", "foreign", "huge", "abort"] = "foreign") -> None:
        """Send a datagram that is no valid packet to the receiver of the stream, uncounted.

        `short`: half a header; `foreign`: a header of unknown content; `huge`: the greatest packet number of 24 bits,
        for which Aravis 0.8.26 allocates 200 MB and stands still; `abort`: the extended trailer that makes it allocate
        38 GB and abort its process.
        """
        datagrams = {
            "short": b"\0\0\0",
            "foreign": struct.pack(">HHI", 0, 0x7777, 0x7F000005) + b"\xa5" * 32,
            "huge": struct.pack(">HHI", 0, 0x7777, 0x03FFFFFF) + bytes(16),
            "abort": struct.pack(">HHIQI", 0, 0, 0x82000000, 0x7777, 0x90000000) + bytes(16),
        }
        self._stream.send_raw(datagrams[kind])

    # --- the control channel ---

    def _answer(self, datagram: bytes, peer: Peer) -> bytes | None:
        with self._lock:
            if not self._is_connected():
                return None
            return self._gvcp.answer(datagram, peer, time.monotonic_ns())

    def _next_due_ns(self) -> int | None:
        with self._lock:
            due_ns = (self._gvcp.heartbeat_due_ns(), self._off_until_ns)
        return min((time_ns for time_ns in due_ns if time_ns is not None), default=None)

    def _run_due(self) -> None:
        with self._lock:
            now_ns = time.monotonic_ns()
            self._gvcp.check_heartbeat(now_ns)
            if self._off_until_ns is not None and now_ns >= self._off_until_ns:
                self._power_on()

    def _is_connected(self) -> bool:
        return self._off_until_ns is None and time.monotonic_ns() >= self._unplugged_until_ns

    # --- power ---

    def _power_off(self, off_s: float) -> None:
        self._off_until_ns = time.monotonic_ns() + round(off_s * 1e9)
        self._sensor.end_acquisition()
        self._stream.disconnect()
        self._gvcp.reset()
        self._note(f"power off for {off_s:g} s")

    def _power_on(self) -> None:
        self._device.power_on(self._design, stream_port=self._stream_port)
        self._off_until_ns = None
        self._note("power on")

    @contextmanager
    def _explained_bind(self, address: str) -> Iterator[None]:
        """Raise `OSError` as `CameraUnavailableError` that names the address and what to do."""
        try:
            yield
        except OSError as err:
            raise CameraUnavailableError(
                self.id,
                f"cannot be simulated at {address}:{GVCP_PORT} ({err.strerror}): "
                "end the simulator that uses it, or choose another address of 127/8",
            ) from err

    def _note(self, event: str) -> None:
        self._log.append(LogEntry(time.monotonic_ns(), event))
