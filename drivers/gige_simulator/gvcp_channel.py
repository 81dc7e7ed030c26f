"""The control channel of a simulated camera: answers GVCP commands, and keeps track of who has control.

No socket and no thread: a datagram goes in with its sender and the time, the acknowledgement comes out.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from drivers.gige_simulator.registers import (
    CONTROL_PRIVILEGE,
    HEARTBEAT_TIMEOUT,
    AckStatus,
    Key,
    RefusedError,
    Registers,
)
from drivers.gvcp import ACK_HEADER, ACK_REQUIRED, ACTION, DISCOVERY, DISCOVERY_BYTES, HEADER, KEY, SCHEDULED

Peer = tuple[str, int]
"""Address and port of an application."""

PACKET_RESEND = 0x40
READ_REGISTER, WRITE_REGISTER, READ_MEMORY, WRITE_MEMORY = 0x80, 0x82, 0x84, 0x86
PENDING_ACK = 0x89

_EXTENDED_IDS = 0x10
_EXCLUSIVE, _CONTROL = 0x1, 0x2
_MAX_MEMORY_BYTES = 536
"""Largest number of bytes of memory in a command or acknowledgement of 576 bytes."""


class CommandEffects(Protocol):
    """The reactions of a camera to commands."""

    def written(self, key: Key) -> None:
        """React to a feature whose register was written; may raise `RefusedError`."""

    def word_written(self, address: int, value: int) -> None:
        """React to a bootstrap register without a feature that was written."""

    def released(self) -> None:
        """React to the end of control: acquisition and stream end."""

    def acted(self, *, at_device_ns: int | None) -> AckStatus:
        """React to an action command with the camera's keys."""

    def resend(self, block_id: int, first: int, last: int, *, has_extended_ids: bool) -> None:
        """Send packets of a block again."""

    def noted(self, event: str) -> None:
        """Log an event, such as a change of control."""


@dataclass(slots=True)
class _LastCommand:
    """The latest command of the controller, and its acknowledgement."""

    datagram: bytes
    answer: bytes | None


class GvcpChannel:
    """The commands of one camera; at most one application has control, until its heartbeat times out."""

    def __init__(self, registers: Registers, device: CommandEffects) -> None:
        self.controller: Peer | None = None
        self.n_heartbeats = 0
        self.n_actions = 0
        self._registers = registers
        self._device = device
        self._is_exclusive = False
        self._heard_ns = 0
        self._last: _LastCommand | None = None
        self._commands: dict[int, Callable[[bytes, Peer], bytes]] = {
            DISCOVERY: self._discovery,
            READ_REGISTER: self._read_registers,
            WRITE_REGISTER: self._write_registers,
            READ_MEMORY: self._read_memory,
            WRITE_MEMORY: self._write_memory,
        }

    def answer(self, datagram: bytes, peer: Peer, now_ns: int) -> bytes | None:
        """Execute a command and return its acknowledgement; None for other datagrams, and where none is required.

        A repeated command of the controller is acknowledged again, not executed again; other applications only read.
        """
        if len(datagram) < HEADER.size or datagram[0] != KEY:
            return None
        _, flags, command, size, request_id = HEADER.unpack_from(datagram)
        body = datagram[HEADER.size :]
        if self.controller in (
            None,
            peer,
        ):  # None: an application that takes control by this command was heard
            self._heard_ns = now_ns
        if command == PACKET_RESEND:
            self._resend(flags, body)
            return None
        if peer == self.controller and self._last and self._last.datagram == datagram:
            return self._last.answer
        answer = b""
        try:
            if size != len(body):
                raise RefusedError(AckStatus.INVALID_HEADER)
            if command == ACTION:
                status = self._action(flags, body)
                if status is None:
                    return None
            elif command in self._commands:
                answer = self._commands[command](body, peer)
                status = AckStatus.SUCCESS
            else:
                status = AckStatus.NOT_IMPLEMENTED
        except RefusedError as refused:
            status, answer = refused.status, refused.answer
        except struct.error:
            status = AckStatus.INVALID_HEADER
        reply = ACK_HEADER.pack(status, command + 1, len(answer), request_id) + answer
        wanted = reply if flags & ACK_REQUIRED else None
        if peer == self.controller:
            self._last = _LastCommand(datagram, wanted)
        return wanted

    def heartbeat_due_ns(self) -> int | None:
        """Return when control ends if nothing is heard until then; None without a controller."""
        if self.controller is None:
            return None
        return self._heard_ns + self._registers.word(HEARTBEAT_TIMEOUT) * 1_000_000

    def check_heartbeat(self, now_ns: int) -> None:
        """End control if the heartbeat has timed out."""
        due_ns = self.heartbeat_due_ns()
        if due_ns is not None and now_ns >= due_ns:
            self._device.noted(f"heartbeat of {_name(self.controller)} ended")
            self.release()

    def release(self) -> None:
        """End the control of any application."""
        self.controller, self._is_exclusive = None, False
        self._registers.put_word(CONTROL_PRIVILEGE, 0)
        self._device.released()

    def seize(self, peer: Peer, *, heard_ns: int) -> None:
        """Give control to `peer`, taking it from any other; its heartbeat counts from `heard_ns`."""
        self._heard_ns = heard_ns
        self._take(peer, _CONTROL)

    def _take(self, peer: Peer, privilege: int) -> None:
        if peer != self.controller:
            self._last = None
        self.controller, self._is_exclusive = peer, bool(privilege & _EXCLUSIVE)
        self._registers.put_word(CONTROL_PRIVILEGE, privilege)
        self._device.noted(f"{'exclusive ' if self._is_exclusive else ''}control to {_name(peer)}")

    def reset(self) -> None:
        """Forget controller and last command, as after power-on."""
        self.controller, self._is_exclusive, self._last = None, False, None

    # --- commands ---

    def _discovery(self, body: bytes, peer: Peer) -> bytes:
        return self._registers.read(0, DISCOVERY_BYTES)

    def _read_registers(self, body: bytes, peer: Peer) -> bytes:
        addresses = [address for (address,) in struct.iter_unpack(">I", body)]
        if addresses != [CONTROL_PRIVILEGE]:
            self._demand_readable(peer)
        elif peer == self.controller:
            self.n_heartbeats += 1
        return b"".join(self._registers.read(address, 4) for address in addresses)

    def _write_registers(self, body: bytes, peer: Peer) -> bytes:
        writes = list(struct.iter_unpack(">I4s", body))
        for n_written, (address, value) in enumerate(writes):
            try:
                if address == CONTROL_PRIVILEGE:
                    self._write_privilege(int.from_bytes(value, "big"), peer)
                else:
                    self._write(address, value, peer)
            except RefusedError as refused:
                raise RefusedError(refused.status, struct.pack(">HH", 0, n_written)) from refused
        return struct.pack(">HH", 0, len(writes))

    def _read_memory(self, body: bytes, peer: Peer) -> bytes:
        address, size = struct.unpack(">IxxH", body)
        if size > _MAX_MEMORY_BYTES:
            raise RefusedError(AckStatus.INVALID_PARAMETER)
        self._demand_readable(peer)
        return body[:4] + self._registers.read(address, size)

    def _write_memory(self, body: bytes, peer: Peer) -> bytes:
        (address,) = struct.unpack_from(">I", body)
        try:
            self._write(address, body[4:], peer)
        except RefusedError as refused:
            raise RefusedError(refused.status, bytes(4)) from refused
        return struct.pack(">HH", 0, len(body) - 4)

    def _write(self, address: int, data: bytes, peer: Peer) -> None:
        if peer != self.controller:
            raise RefusedError(AckStatus.ACCESS_DENIED)
        keys = self._registers.write(address, data)
        for key in keys:
            self._device.written(key)
        if not keys:
            self._device.word_written(address, int.from_bytes(data[:4], "big"))

    def _demand_readable(self, peer: Peer) -> None:
        if self._is_exclusive and peer != self.controller:
            raise RefusedError(AckStatus.ACCESS_DENIED)

    def _write_privilege(self, value: int, peer: Peer) -> None:
        if self.controller not in (None, peer):
            raise RefusedError(AckStatus.ACCESS_DENIED)
        if value & (_CONTROL | _EXCLUSIVE):
            self._take(peer, value & (_CONTROL | _EXCLUSIVE))
        elif self.controller is not None:
            self._device.noted(f"{_name(peer)} left control")
            self.release()

    def _action(self, flags: int, body: bytes) -> AckStatus | None:
        """Act if the keys are the camera's; otherwise return None, as the command is for other cameras."""
        device_key, group_key, group_mask = struct.unpack_from(">III", body)
        registers = self._registers
        if (
            device_key != registers.number("ActionDeviceKey")
            or group_key != registers.number("ActionGroupKey")
            or not group_mask & registers.number("ActionGroupMask")
        ):
            return None
        self.n_actions += 1
        at_device_ns = struct.unpack_from(">Q", body, 12)[0] if flags & SCHEDULED else None
        return self._device.acted(at_device_ns=at_device_ns)

    def _resend(self, flags: int, body: bytes) -> None:
        has_extended_ids = bool(flags & _EXTENDED_IDS)
        if len(body) < (20 if has_extended_ids else 12):
            return
        _, block_id, first, last = struct.unpack_from(">HHII", body)
        if has_extended_ids:
            (block_id,) = struct.unpack_from(">Q", body, 12)
        else:
            first, last = first & 0xFFFFFF, last & 0xFFFFFF
        self._device.resend(block_id, first, last, has_extended_ids=has_extended_ids)


def is_discovery(datagram: bytes) -> bool:
    """True for a discovery command, which is answered without delay."""
    return datagram[2:4] == DISCOVERY.to_bytes(2, "big")


def pending_ack(datagram: bytes, delay_ms: int) -> bytes | None:
    """Return the pending acknowledgement of a command, None if the datagram is no command."""
    if len(datagram) < HEADER.size or datagram[0] != KEY:
        return None
    _, _, _, _, request_id = HEADER.unpack_from(datagram)
    return ACK_HEADER.pack(AckStatus.SUCCESS, PENDING_ACK, 4, request_id) + struct.pack(">HH", 0, delay_ms)


def _name(peer: Peer | None) -> str:
    return f"{peer[0]}:{peer[1]}" if peer else "nobody"
