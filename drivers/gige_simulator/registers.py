"""The memory of a simulated camera: addresses, alignment, access rights, ranges and live values of its registers.

Below 0xB000 lie the bootstrap registers of the GigE Vision standard, from 0x10000 those of the features, from
0x100000 the GenICam XML. All numbers are big endian.
"""

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

from drivers.gige_simulator.features import Feature

BOOTSTRAP_BYTES = 0xB000
FEATURES_ADDRESS = 0x10000
XML_ADDRESS = 0x100000

HEARTBEAT_TIMEOUT = 0x938
TIMESTAMP_CONTROL = 0x944
CONTROL_PRIVILEGE = 0xA00
STREAM_PORT = 0xD00
STREAM_ADDRESS = 0xD18
STREAM_SOURCE_PORT = 0xD1C

Value = int | float | str
Key = tuple[str, int]
"""A feature's key, and its bank: the entry of its selector that it belongs to, 0 without a selector."""


class AckStatus(IntEnum):
    """Status codes of an acknowledgement."""

    SUCCESS = 0x0000
    NOT_IMPLEMENTED = 0x8001
    INVALID_PARAMETER = 0x8002
    INVALID_ADDRESS = 0x8003
    WRITE_PROTECT = 0x8004
    BAD_ALIGNMENT = 0x8005
    ACCESS_DENIED = 0x8006
    BUSY = 0x8007
    PACKET_UNAVAILABLE = 0x800C
    INVALID_HEADER = 0x800E
    NO_REFERENCE_TIME = 0x8013
    ACTION_LATE = 0x8016


class RefusedError(Exception):
    """The camera refuses a command with `status`; `answer` is the body of the acknowledgement."""

    def __init__(self, status: AckStatus, answer: bytes = b"") -> None:
        super().__init__(status.name)
        self.status = status
        self.answer = answer


@dataclass(slots=True)
class _Register:
    length: int
    access: str  # of the most permissive feature in it
    parts: list[Key] = field(default_factory=list)


class Registers:
    """Memory with rules of access; values in `live` are computed at every read."""

    def __init__(self, features: Sequence[Feature], *, clamps: bool, encoding: str = "utf-8") -> None:
        self.features = {feature.key: feature for feature in features}
        self.live: dict[str, Callable[[int], int | float]] = {}
        self.is_acquiring = False
        self.xml = b""
        self.version = 0  # goes up whenever a setting may have changed
        self._clamps = clamps
        self._encoding = encoding  # of texts
        self._registers: dict[int, _Register] = {}
        self._addresses = self._allot()
        end = max(address + self._registers[address].length for address in self._registers)
        self._memory = bytearray(max(end, FEATURES_ADDRESS))
        for address in (CONTROL_PRIVILEGE, STREAM_PORT, STREAM_ADDRESS, TIMESTAMP_CONTROL):
            self._registers[address] = _Register(4, "RW")
        self.reset()

    def reset(self) -> None:
        """Clear the memory and set all features to their defaults, as after power-on."""
        self.version += 1
        self.is_acquiring = False
        self._memory[:] = bytes(len(self._memory))
        for key, bank in self._keys():
            feature = self.features[key]
            self.put(key, "" if feature.kind == "string" else feature.value, bank)

    def _allot(self) -> dict[Key, int]:
        addresses: dict[Key, int] = {}
        free = FEATURES_ADDRESS
        for key, bank in self._keys():
            feature = self.features[key]
            address = feature.address
            if address is None:
                address, free = free, free + feature.length
            addresses[key, bank] = address
            register = self._registers.setdefault(address, _Register(feature.length, feature.access))
            register.parts.append((key, bank))
        return addresses

    def _keys(self) -> Iterator[Key]:
        for feature in self.features.values():
            for bank in range(self.n_banks(feature)):
                yield feature.key, bank

    def n_banks(self, feature: Feature) -> int:
        """Return the number of registers of a feature: one for each entry of its selector."""
        return len(self.features[feature.selector].entries) if feature.selector else 1

    def address(self, key: str, bank: int = 0) -> int:
        """Return the address of a feature's register."""
        return self._addresses[key, bank]

    # --- the camera's side: physical values, no rules ---

    def get(self, key: str, bank: int = 0) -> Value:
        """Return the value of a feature."""
        feature = self.features[key]
        address = self._addresses[key, bank]
        data = bytes(self._memory[address : address + feature.length])
        if feature.kind == "string":
            return data.split(b"\0")[0].decode(self._encoding)
        if feature.kind == "float":
            return float(struct.unpack(">d", data)[0])
        raw = _extract(feature, int.from_bytes(data, "big"))
        return raw if feature.scale == 1 else raw * feature.scale

    def number(self, key: str, bank: int = 0) -> int:
        """Return the value of an integer, boolean or enumeration."""
        return int(self.get(key, bank))

    def quantity(self, key: str, bank: int = 0) -> float:
        """Return the value of a float in its physical unit."""
        return float(self.get(key, bank))

    def choice(self, key: str, bank: int = 0) -> str:
        """Return the name of the chosen entry of an enumeration."""
        value = self.number(key, bank)
        return next(name for name, number in self.features[key].entries.items() if number == value)

    def number_or(self, key: str, default: int, bank: int = 0) -> int:
        """Return the value of an integer, boolean or enumeration; the default in a camera without it."""
        return self.number(key, bank) if key in self.features else default

    def quantity_or(self, key: str, default: float, bank: int = 0) -> float:
        """Return the value of a float; the default in a camera without it."""
        return self.quantity(key, bank) if key in self.features else default

    def choice_or(self, key: str, default: str, bank: int = 0) -> str:
        """Return the name of the chosen entry of an enumeration; the default in a camera without it."""
        return self.choice(key, bank) if key in self.features else default

    def put(self, key: str, value: Value, bank: int = 0) -> None:
        """Set the value of a feature."""
        feature = self.features[key]
        address = self._addresses[key, bank]
        if isinstance(value, str):
            data = value.encode(self._encoding)[: feature.length].ljust(feature.length, b"\0")
        elif feature.kind == "float":
            data = struct.pack(">d", value)
        else:
            word = int.from_bytes(self._memory[address : address + feature.length], "big")
            data = _insert(feature, word, round(value / feature.scale)).to_bytes(feature.length, "big")
        self._memory[address : address + feature.length] = data
        self.version += feature.access == "RW"

    def word(self, address: int) -> int:
        """Return the 32-bit word at a bootstrap address."""
        return int(struct.unpack_from(">I", self._memory, address)[0])

    def put_word(self, address: int, word: int) -> None:
        struct.pack_into(">I", self._memory, address, word & 0xFFFFFFFF)

    def put_text(self, address: int, text: str) -> None:
        self._memory[address : address + len(text)] = text.encode("ascii")

    def defaults(self) -> dict[Key, Value]:
        """Return the content of the user set `Default`."""
        return {(key, bank): self.features[key].value for key, bank in self._kept()}

    def saved(self) -> dict[Key, Value]:
        """Return the present values of all features that a user set keeps."""
        return {(key, bank): self.get(key, bank) for key, bank in self._kept()}

    def _kept(self) -> Iterator[Key]:
        for key, bank in self._keys():
            feature = self.features[key]
            if feature.is_kept and feature.access == "RW" and feature.kind != "string":
                yield key, bank

    def restore(self, values: Mapping[Key, Value]) -> None:
        for (key, bank), value in values.items():
            self.put(key, value, bank)

    # --- the control channel's side: addresses and rules ---

    def read(self, address: int, size: int) -> bytes:
        """Return `size` bytes from `address`; raises `RefusedError`."""
        if address % 4 or size % 4:
            raise RefusedError(AckStatus.BAD_ALIGNMENT)
        if address >= XML_ADDRESS and address + size <= XML_ADDRESS + len(self.xml) + 3:
            return self.xml[address - XML_ADDRESS :][:size].ljust(size, b"\0")
        if not (
            address + size <= BOOTSTRAP_BYTES
            or (address >= FEATURES_ADDRESS and address + size <= len(self._memory))
        ):
            raise RefusedError(AckStatus.INVALID_ADDRESS)
        if self.live:
            self._refresh(address, size)
        return bytes(self._memory[address : address + size])

    def _refresh(self, address: int, size: int) -> None:
        for start in range(address, address + size, 4):
            register = self._registers.get(start)
            for key, bank in register.parts if register else ():
                if key in self.live:
                    self.put(key, self.live[key](bank), bank)

    def write(self, address: int, data: bytes) -> list[Key]:
        """Write one register and return the keys of the features in it; raises `RefusedError`."""
        if address % 4 or len(data) % 4:
            raise RefusedError(AckStatus.BAD_ALIGNMENT)
        register = self._registers.get(address)
        if register is None:
            is_known = address + len(data) <= BOOTSTRAP_BYTES
            raise RefusedError(AckStatus.WRITE_PROTECT if is_known else AckStatus.INVALID_ADDRESS)
        if len(data) > register.length:
            raise RefusedError(AckStatus.INVALID_ADDRESS)
        if register.access == "RO":
            raise RefusedError(AckStatus.WRITE_PROTECT)
        accepted = bytes(self._memory[address : address + register.length])
        offered = data + accepted[len(data) :]
        for key, _ in register.parts:
            accepted = self._accept(self.features[key], accepted, offered)
        self._memory[address : address + register.length] = accepted if register.parts else offered
        self.version += 1
        return register.parts

    def _accept(self, feature: Feature, old: bytes, offered: bytes) -> bytes:
        """Return the register `old` with the part of one feature taken from `offered`; raises `RefusedError`."""
        if feature.kind == "string":
            return offered
        if feature.kind == "float":
            old_value, value = struct.unpack(">d", old)[0], struct.unpack(">d", offered)[0]
        else:
            old_value = _extract(feature, int.from_bytes(old, "big"))
            value = _extract(feature, int.from_bytes(offered, "big"))
        is_change = value != old_value or feature.kind == "command"
        if self.is_acquiring and feature.is_locked and is_change:
            raise RefusedError(AckStatus.BUSY)
        value = self._within_range(feature, value)
        if feature.kind == "float":
            return struct.pack(">d", value)
        return _insert(feature, int.from_bytes(old, "big"), round(value)).to_bytes(len(old), "big")

    def _within_range(self, feature: Feature, value: float) -> float:
        """Return the raw value that the register accepts for a raw `value`; raises `RefusedError`."""
        if feature.kind in ("boolean", "command"):
            return value
        if feature.kind == "enumeration":
            if value in feature.entries.values():
                return value
            raise RefusedError(AckStatus.INVALID_PARAMETER)
        minimum, maximum = feature.minimum, feature.maximum
        if feature.bounds:
            minimum, maximum = map(self.quantity, feature.bounds)
        if feature.limit:
            whole, part = feature.limit
            maximum = self.number(whole) - self.number(part)
        step = None if feature.kind == "float" else feature.increment
        lowest, highest = round(minimum / feature.scale, 6), round(maximum / feature.scale, 6)
        if lowest <= value <= highest and (step is None or value % step == 0):
            return value
        if not self._clamps or value != value:  # nan
            raise RefusedError(AckStatus.INVALID_PARAMETER)
        clamped = min(max(value, lowest), highest)
        return clamped if step is None else clamped - clamped % step


def _extract(feature: Feature, word: int) -> int:
    """Return the feature's bits of a register, as two's complement where its range is below zero."""
    first, last = feature.bits
    if feature.length == 8:
        first, last = 0, 63
    n_bits = last - first + 1
    raw = (word >> (8 * feature.length - 1 - last)) & ((1 << n_bits) - 1)
    return raw - (1 << n_bits) if feature.minimum < 0 and raw >> (n_bits - 1) else raw


def _insert(feature: Feature, word: int, raw: int) -> int:
    first, last = feature.bits
    if feature.length == 8:
        first, last = 0, 63
    mask = (1 << (last - first + 1)) - 1
    shift = 8 * feature.length - 1 - last
    return word & ~(mask << shift) | (raw & mask) << shift
