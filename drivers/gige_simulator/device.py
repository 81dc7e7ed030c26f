"""The effects and live values of the registers of a simulated camera."""

import math
import time
from collections.abc import Callable, Mapping
from ipaddress import IPv4Address

from drivers.gige_simulator.bootstrap import VENDOR, put_bootstrap
from drivers.gige_simulator.clock import CameraClock
from drivers.gige_simulator.design import CameraDesign
from drivers.gige_simulator.faults import Faults
from drivers.gige_simulator.feature_table import EXPOSURE_LIMITS, USER_OUTPUTS, feature_table
from drivers.gige_simulator.features import PIXEL_FORMATS, PTP_STATES
from drivers.gige_simulator.genicam_xml import genicam_xml, zipped
from drivers.gige_simulator.gvsp import IP_UDP_BYTES, chunk_bytes
from drivers.gige_simulator.imaging import reduction
from drivers.gige_simulator.registers import (
    STREAM_ADDRESS,
    STREAM_PORT,
    TIMESTAMP_CONTROL,
    AckStatus,
    Key,
    RefusedError,
    Registers,
    Value,
)
from drivers.gige_simulator.sensor import Sensor
from drivers.gige_simulator.stream import StreamChannel

_USER_SETS = ("Default", "UserSet1")
_REDUCTIONS = ("BinningHorizontal", "BinningVertical", "DecimationHorizontal", "DecimationVertical")


def make_registers(design: CameraDesign) -> Registers:
    """Return the registers of a camera with its GenICam XML; the legacy dialect clamps values that others refuse."""
    ways = design.ways
    table = feature_table(ways, design.image_size_px, throughput_bytes_s=design.link_bytes_s)
    registers = Registers(table, clamps=ways.dialect == "legacy", encoding=ways.encoding)
    xml = genicam_xml(registers, vendor=VENDOR, model=ways.model)
    registers.xml = zipped(xml, f"{ways.model}.xml") if design.is_xml_zipped else xml
    return registers


class CameraDevice:
    """The `CommandEffects` of a camera; called under the camera's lock."""

    _design: CameraDesign  # as it was last switched on

    def __init__(
        self,
        *,
        registers: Registers,
        sensor: Sensor,
        stream: StreamChannel,
        clock: CameraClock,
        faults: Faults,
        note: Callable[[str], None],
        restart: Callable[[], None],
    ) -> None:
        self.noted = note
        self._registers = registers
        self._sensor = sensor
        self._stream = stream
        self._clock = clock
        self._faults = faults
        self._restart = restart
        self._on_since_s = time.monotonic()
        self._counter_bases = [0, 0]
        self._serial = ""
        self._user_name = ""
        self._user_sets: dict[str, Mapping[Key, Value]] = {}
        self._startup_set = "Default"
        self._latched_offset_ns = 0
        self._mtu_bytes = 0
        self.blinks = 0
        """How often its lamp has lit up at the word of a host."""
        self._is_lit = False
        self._effects: dict[str, Callable[[int], None]] = {
            "AcquisitionStart": self._start_acquisition,
            "AcquisitionStop": lambda _: sensor.end_acquisition(),
            "TriggerMode": lambda _: sensor.trigger_mode_changed(),
            "TriggerSoftware": lambda bank: sensor.edge("Software", time.monotonic_ns(), bank=bank),
            "DeviceReset": lambda _: restart(),
            "TimestampLatch": lambda _: self._latch_timestamp(),
            "UserSetLoad": self._load_user_set,
            "UserSetSave": self._save_user_set,
            "UserSetDefault": self._choose_startup_set,
            "DeviceUserID": self._name,
            "CounterReset": self._reset_counter,
            "CounterEventSource": self._reset_counter,
            "PtpEnable": lambda _: clock.set_ptp(is_enabled=bool(registers.number("PtpEnable"))),
            "PtpDataSetLatch": self._latch_ptp,
            "GevSCPSFireTestPacket": self._fire_test_packet,
            **dict.fromkeys((*_REDUCTIONS, "ExposureTimeMode"), self._derive),
            **dict.fromkeys(
                ("DeviceIndicatorMode", "LineMode", "LineSource", "UserOutputValue"), self._see_lamp
            ),
        }
        registers.live.update(
            DeviceTemperature=lambda _: self._temperature_c(),
            AcquisitionStatus=lambda _: int(registers.is_acquiring),
            LineStatus=lambda bank: int(sensor.level(bank)),
            CounterValue=lambda bank: self._events(bank) - self._counter_bases[bank],
            PayloadSize=lambda _: self._payload_bytes(),
            PtpStatus=lambda _: PTP_STATES.index(self._ptp_state()),
            PtpOffsetFromMaster=lambda _: self._latched_offset_ns,
        )

    def power_on(self, design: CameraDesign, *, stream_port: int) -> None:
        """Forget everything but the non-volatile memory: user name and user sets."""
        registers = self._registers
        if design.serial != self._serial:  # another device
            self._serial, self._user_name, self._startup_set = design.serial, "", "Default"
            self._user_sets.clear()
        self._design = design
        registers.reset()
        put_bootstrap(registers, design, stream_port)
        registers.put("DeviceUserID", self._user_name or design.user_name)
        registers.put("UserSetDefault", _USER_SETS.index(self._startup_set))
        registers.restore(self._user_sets.get(self._startup_set, {}))
        for key, setting in design.ways.left_on.items():
            if isinstance(setting, str):
                setting = registers.features[key].entries[setting]
            registers.put(key, setting)
        self._derive(0)
        self._clock.restart()
        self._clock.set_ptp(is_enabled=bool(registers.number("PtpEnable")))
        self._sensor.power_on()
        self._is_lit = self.is_lit
        self._counter_bases = [self._events(bank) for bank in range(len(self._counter_bases))]
        self._mtu_bytes = design.mtu_bytes
        self._on_since_s = time.monotonic()

    # --- effects of commands ---

    def written(self, key: Key) -> None:
        name, bank = key
        registers = self._registers
        is_command = registers.features[name].kind == "command" or name == "GevSCPSFireTestPacket"
        if is_command and not registers.number(name, bank):
            return
        try:
            if effect := self._effects.get(name):
                effect(bank)
        finally:
            if is_command:
                registers.put(name, 0, bank)

    def word_written(self, address: int, value: int) -> None:
        if address == TIMESTAMP_CONTROL:
            if value & 1:  # reset
                self._clock.jump(-self._clock.device_ns(time.monotonic_ns()))
            if value & 2:
                self._latch_timestamp()

    def released(self) -> None:
        self._sensor.end_acquisition()
        self._stream.disconnect()
        self._registers.put_word(STREAM_PORT, 0)
        self._registers.put("TLParamsLocked", 0)

    def acted(self, *, at_device_ns: int | None) -> AckStatus:
        at_ns = time.monotonic_ns()
        if at_device_ns is not None:
            if self._clock.ptp_state() != "Slave":
                return AckStatus.NO_REFERENCE_TIME
            at_ns = self._clock.host_ns(at_device_ns)
            if at_ns < time.monotonic_ns():
                return AckStatus.ACTION_LATE
        self._sensor.edge(self._design.ways.action, at_ns)
        return AckStatus.SUCCESS

    def resend(self, block_id: int, first: int, last: int, *, has_extended_ids: bool) -> None:
        self._stream.resend(block_id, first, last, has_extended_ids=has_extended_ids)

    # --- effects of features ---

    def _derive(self, _: int) -> None:
        """Let the ranges of features follow the features that they depend on."""
        registers = self._registers
        for extent, offset, direction in (
            ("Width", "OffsetX", "Horizontal"),
            ("Height", "OffsetY", "Vertical"),
        ):
            most = registers.number(f"Sensor{extent}") // reduction(registers, direction)
            registers.put(f"{extent}Max", most)
            registers.put(extent, min(registers.number(extent), most - registers.number(offset)))
        if modes_us := self._design.ways.exposure_modes_us:
            limits = modes_us[registers.choice("ExposureTimeMode")]
            for key, limit in zip(EXPOSURE_LIMITS, limits, strict=True):
                registers.put(key, limit)
            registers.put("ExposureTime", min(max(registers.quantity("ExposureTime"), limits[0]), limits[1]))

    def _destination(self) -> tuple[str, int]:
        address = IPv4Address(self._registers.word(STREAM_ADDRESS))
        return str(address), self._registers.word(STREAM_PORT) & 0xFFFF

    def _start_acquisition(self, _: int) -> None:
        address, port = self._destination()
        if port:
            self._stream.connect(address, port)
        self._sensor.begin_acquisition()

    def _fire_test_packet(self, _: int) -> None:
        size = self._registers.number("GevSCPSPacketSize")
        destination = self._destination()
        if destination[1] and size <= self._mtu_bytes:
            self._stream.send_raw(bytes(size - IP_UDP_BYTES), destination)

    def _latch_timestamp(self) -> None:
        self._registers.put("TimestampLatchValue", self._clock.device_ns(time.monotonic_ns()))

    def _latch_ptp(self, _: int) -> None:
        self._latched_offset_ns = self._clock.ptp_offset_ns()

    def _chosen_set(self) -> str:
        return self._registers.choice("UserSetSelector")

    def _load_user_set(self, _: int) -> None:
        registers = self._registers
        chosen = self._user_sets.get(self._chosen_set())
        registers.restore(registers.defaults() if chosen is None else chosen)
        self._derive(0)
        self._clock.set_ptp(is_enabled=bool(registers.number("PtpEnable")))

    def _save_user_set(self, _: int) -> None:
        if self._chosen_set() == "Default":
            raise RefusedError(AckStatus.WRITE_PROTECT)
        self._user_sets[self._chosen_set()] = self._registers.saved()

    def _choose_startup_set(self, _: int) -> None:
        self._startup_set = self._registers.choice("UserSetDefault")

    def _name(self, _: int) -> None:
        self._user_name = str(self._registers.get("DeviceUserID"))

    def _reset_counter(self, bank: int) -> None:
        self._counter_bases[bank] = self._events(bank)

    def _see_lamp(self, _: int) -> None:
        was_lit, self._is_lit = self._is_lit, self.is_lit
        self.blinks += self._is_lit and not was_lit

    # --- live values ---

    @property
    def is_lit(self) -> bool:
        """Whether its status lamp shines, or without one what hangs on an output that the host may switch."""
        registers = self._registers
        if "DeviceIndicatorMode" in registers.features:
            return registers.choice("DeviceIndicatorMode") == "Active"
        high = [
            output for bank, output in enumerate(USER_OUTPUTS) if registers.number("UserOutputValue", bank)
        ]
        return any(
            registers.choice("LineMode", bank) == "Output" and registers.choice("LineSource", bank) in high
            for bank in registers.features["LineSelector"].entries.values()
        )

    def _ptp_state(self) -> str:
        state = self._clock.ptp_state()
        return "Master" if self._design.is_clock_master and state in ("Uncalibrated", "Slave") else state

    def _temperature_c(self) -> float:
        """Return a temperature that rises by 9 K within minutes and then wavers by a few tenths."""
        if self._faults.temperature_c is not None:
            return self._faults.temperature_c
        on_s = time.monotonic() - self._on_since_s
        return 36.0 + 9.0 * (1 - math.exp(-on_s / 300)) + 0.3 * math.sin(on_s / 20)

    def _events(self, bank: int) -> int:
        tally = self._sensor.tally
        return {
            "Off": 0,
            "FrameTrigger": tally.heard,
            "FrameTriggerMissed": tally.heard - tally.triggers,
            "ExposureStart": tally.started,
        }[self._registers.choice("CounterEventSource", bank)]

    def _payload_bytes(self) -> int:
        registers = self._registers
        n_bits = PIXEL_FORMATS[registers.choice("PixelFormat")] >> 16 & 0xFF
        n_image = -(-registers.number("Width") * registers.number("Height") * n_bits // 8)
        if not registers.number("ChunkModeActive"):
            return n_image
        n_banks = registers.n_banks(registers.features["ChunkEnable"])
        return chunk_bytes(n_image, sum(registers.number("ChunkEnable", bank) for bank in range(n_banks)))
