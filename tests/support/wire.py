"""Protocol Buffers as they are on the wire, without any definition of a message: as `protoc --decode_raw` has them."""

import struct
from typing import Any


def fields_of(content: bytes) -> list[tuple[int, Any]]:
    """Return number and value of each field in order; what has a length is bytes."""
    found: list[tuple[int, Any]] = []
    at = 0
    while at < len(content):
        tag, at = _varint(content, at)
        match tag & 7:
            case 0:
                value, at = _varint(content, at)
            case 1:
                (value,) = struct.unpack_from("<d", content, at)
                at += 8
            case 2:
                length, at = _varint(content, at)
                value, at = content[at : at + length], at + length
                assert at <= len(content), "torn"
            case kind:
                raise AssertionError(f"wire type {kind}")
        found.append((tag >> 3, value))
    return found


def _varint(content: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        value |= (content[at] & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if not content[at - 1] & 0x80:
            return value, at
