"""A packet filter in the kernel, in front of a stream's socket: only its camera's frames reach Aravis.

Aravis believes the packet number of any datagram: one of 2^31 makes it allocate 38 GB, and the process aborts. So the
kernel drops what comes from another address, is no leader, payload or trailer, or has a number that no frame of the
camera has. The filter is classic BPF (Linux: Documentation/networking/filter.rst), which sees a datagram from its UDP
header on; layouts are those of GigE Vision 2.0, 24.
"""

import ctypes
import ipaddress
import socket
import struct
from collections.abc import Sequence
from math import ceil
from typing import NamedTuple

_SO_ATTACH_FILTER = 26
_LOAD_LENGTH, _LOAD_BYTE, _LOAD_WORD = 0x80, 0x30, 0x20
_JUMP, _IF_EQUAL, _IF_GREATER, _IF_ANY_BIT, _AND, _RETURN = 0x05, 0x15, 0x25, 0x45, 0x54, 0x06
_IP_SOURCE = 0xFFF0_0000 + 12
"""Where the sender's address is: SKF_NET_OFF, and its place in the header of IPv4."""
_UDP_BYTES, _IP_UDP_BYTES = 8, 28
_STANDARD_BYTES, _EXTENDED_BYTES = 8, 20
"""Headers of the stream protocol, with block numbers of 16 bits and of 64."""
_CONTENT, _EXTENDED_NUMBER = _UDP_BYTES + 4, _UDP_BYTES + 16
"""Where the kind of packet is, in one word with a packet number of 24 bits, and where one of 32 bits is."""
_IS_EXTENDED, _KIND = 0x80, 0x7F
_LEADER, _PAYLOAD = 1, 3
"""First and last kind of packet of a frame; the trailer's is between them."""
_DROP = -1
"""Stands for the distance to the last instruction, which drops the datagram."""


class Instruction(NamedTuple):
    """One instruction; a comparison skips `if_true` or `if_false` of those after it."""

    code: int
    value: int = 0
    if_true: int = 0
    if_false: int = 0


def max_packet_number(payload_bytes: int, packet_bytes: int) -> int:
    """Return the greatest packet number of a frame, its trailer's; packets count with the headers of IP and UDP."""
    data_bytes = packet_bytes - _IP_UDP_BYTES - _EXTENDED_BYTES
    return ceil(payload_bytes / max(data_bytes, 1)) + 1


def stream_program(camera_address: str, max_number: int) -> Sequence[Instruction]:
    """Return the program that lets pass what a camera sends of frames with packet numbers up to this one."""
    program = [
        Instruction(_LOAD_WORD, _IP_SOURCE),
        Instruction(_IF_EQUAL, int(ipaddress.IPv4Address(camera_address)), 0, _DROP),
        Instruction(_LOAD_LENGTH),
        Instruction(_IF_GREATER, _UDP_BYTES + _STANDARD_BYTES - 1, 0, _DROP),
        Instruction(_LOAD_BYTE, _CONTENT),
        Instruction(_AND, _KIND),
        Instruction(_IF_GREATER, _LEADER - 1, 0, _DROP),
        Instruction(_IF_GREATER, _PAYLOAD, _DROP, 0),
        Instruction(_LOAD_BYTE, _CONTENT),
        Instruction(_IF_ANY_BIT, _IS_EXTENDED, 3, 0),
        # the packet number
        Instruction(_LOAD_WORD, _CONTENT),
        Instruction(_AND, 0xFF_FFFF),
        Instruction(_JUMP, 3),
        Instruction(_LOAD_LENGTH),
        Instruction(_IF_GREATER, _UDP_BYTES + _EXTENDED_BYTES - 1, 0, _DROP),
        Instruction(_LOAD_WORD, _EXTENDED_NUMBER),
        Instruction(_IF_GREATER, max_number, _DROP, 0),
        Instruction(_RETURN, 0xFFFF_FFFF),
        Instruction(_RETURN, 0),
    ]
    return [
        instruction._replace(
            if_true=_distance(instruction.if_true, at, len(program)),
            if_false=_distance(instruction.if_false, at, len(program)),
        )
        for at, instruction in enumerate(program)
    ]


def _distance(skipped: int, at: int, n: int) -> int:
    """Return the number of instructions that a jump skips, with `_DROP` for all up to the last of n."""
    return n - 2 - at if skipped == _DROP else skipped


def attach_filter(stream: socket.socket, program: Sequence[Instruction]) -> None:
    """Attach the program to this socket as a kernel filter of its datagrams; raises `OSError` if that fails."""
    code = b"".join(
        struct.pack("HBBI", each.code, each.if_true, each.if_false, each.value) for each in program
    )
    memory = ctypes.create_string_buffer(code, len(code))
    stream.setsockopt(
        socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HP", len(program), ctypes.addressof(memory))
    )
