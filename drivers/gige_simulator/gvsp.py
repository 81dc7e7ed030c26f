"""Lay an image out as the packets of one block of GigE Vision's stream protocol (GVSP).

Byte layouts are those that Aravis accepts and Wireshark dissects.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.gige_simulator.features import CHUNKS, MONO8, PIXEL_FORMATS
from pipeline.arrays import GreyImage

IP_UDP_BYTES = 28
"""Size of the headers of IP and UDP, which the packet size includes."""
ETHERNET_BYTES = 38
"""Preamble, header, checksum and gap of a packet on the wire, which it does not include."""
STANDARD_HEADER = struct.Struct(">HHI")
EXTENDED_HEADER = struct.Struct(">HHIQI")

_LEADER, _TRAILER, _PAYLOAD = 1, 2, 3
_EXTENDED_IDS = 0x80
_IMAGE = 0x0001
_OLD_CHUNKS = 0x0004
_IMAGE_CHUNK = 0x100

Packet = bytes | memoryview


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """One frame to be sent."""

    block_id: int
    has_extended_ids: bool
    packet_bytes: int  # with the headers of IP and UDP
    device_ns: int
    image: GreyImage
    offset_px: tuple[int, int]
    chunks: tuple[tuple[str, int | float], ...] | None  # None: chunk mode is off
    chunk_payload: int = 0x4001  # payload type with chunks
    pixel_format: str = "Mono8"


def packets(block: Block) -> Sequence[Packet]:
    """Return leader, payload and trailer of a block; the index is the packet id. The image is copied."""
    height, width = block.image.shape
    payload = in_format(np.ascontiguousarray(block.image).reshape(-1), block.pixel_format)
    payload_type = _IMAGE
    if block.chunks is not None:
        payload_type = block.chunk_payload
        tail = _chunk_tail(payload.size, block.chunks)
        payload = np.concatenate([payload, np.frombuffer(tail, np.uint8)])
    bodies = _payload_packets(block, payload)
    leader = _header(block, _LEADER, 0) + struct.pack(">HHQ", 0, payload_type, block.device_ns)
    if payload_type != _OLD_CHUNKS:  # these say nothing of the image
        code = PIXEL_FORMATS[block.pixel_format]
        leader += struct.pack(">IIIIIHH", code, width, height, *block.offset_px, 0, 0)
    trailer = _header(block, _TRAILER, len(bodies) + 1) + struct.pack(">HHI", 0, payload_type, height)
    if block.chunks is not None:
        trailer += struct.pack(">II", payload.size, 0)  # length of the chunk data, layout id
    return [leader, *bodies, trailer]


def in_format(grey: GreyImage, name: str) -> GreyImage:
    """Return grey pixels (N,) as bytes of a pixel format, their lower bits set: a receiver must not look at them."""
    code = PIXEL_FORMATS[name]
    if code == MONO8:
        return grey
    n_bits = int("".join(filter(str.isdigit, name)))
    deep = grey.astype(np.uint16) << (n_bits - 8) | ((1 << (n_bits - 8)) - 1)
    if name.endswith("p"):
        bits = np.unpackbits(deep.astype("<u2").view(np.uint8).reshape(-1, 2), axis=1, bitorder="little")
        return np.packbits(bits[:, :n_bits].reshape(-1), bitorder="little")
    if name.endswith("Packed"):
        first, second = np.pad(deep, (0, deep.size % 2)).reshape(-1, 2).T
        low = (1 << (n_bits - 8)) - 1
        triple = (first >> (n_bits - 8), first & low | (second & low) << 4, second >> (n_bits - 8))
        return np.stack(triple, axis=1).astype(np.uint8).reshape(-1)[: -(-deep.size * 12 // 8)]
    return deep.astype("<u2").view(np.uint8)


def unavailable(block_id: int, packet_id: int, status: int, *, has_extended_ids: bool) -> bytes:
    """Return the answer to a request for a packet that is not kept any more."""
    if has_extended_ids:
        return EXTENDED_HEADER.pack(status, 0, (_PAYLOAD | _EXTENDED_IDS) << 24, block_id, packet_id)
    return STANDARD_HEADER.pack(status, block_id, _PAYLOAD << 24 | packet_id)


def chunk_bytes(n_image: int, n_chunks: int) -> int:
    """Return the size of a payload with chunks: the image and each chunk carry an id and a length."""
    return n_image + 8 + n_chunks * 16


def _header(block: Block, content: int, packet_id: int) -> bytes:
    if block.has_extended_ids:
        return EXTENDED_HEADER.pack(0, 0, (content | _EXTENDED_IDS) << 24, block.block_id, packet_id)
    return STANDARD_HEADER.pack(0, block.block_id, content << 24 | packet_id)


def _payload_packets(block: Block, payload: GreyImage) -> list[memoryview]:
    """Return the payload (N,) in packets of header and data; the last one is as short as possible."""
    n_header = (EXTENDED_HEADER if block.has_extended_ids else STANDARD_HEADER).size
    n_data = block.packet_bytes - IP_UDP_BYTES - n_header
    n_packets = -(-payload.size // n_data)
    n_full = payload.size // n_data
    n_rest = payload.size - n_full * n_data
    rows = np.empty((n_packets, n_header + n_data), np.uint8)
    rows[:, :n_header] = np.frombuffer(_header(block, _PAYLOAD, 0), np.uint8)
    packet_ids = np.arange(1, n_packets + 1, dtype=">u4").view(np.uint8).reshape(-1, 4)
    rows[:, n_header - 3 : n_header] = packet_ids[:, 1:]  # 24 bit are enough with either kind of ids
    rows[:n_full, n_header:] = payload[: n_full * n_data].reshape(n_full, n_data)
    rows[n_full:, n_header : n_header + n_rest] = payload[n_full * n_data :]
    view, stride = rows.reshape(-1).data, rows.shape[1]
    ends = [stride] * n_full + [n_header + n_rest] * (n_packets - n_full)
    return [view[row * stride : row * stride + end] for row, end in enumerate(ends)]


def _chunk_tail(n_image: int, chunks: tuple[tuple[str, int | float], ...]) -> bytes:
    tail = struct.pack(">II", _IMAGE_CHUNK, n_image)
    for name, value in chunks:
        data = struct.pack(">d", value) if isinstance(value, float) else struct.pack(">Q", value)
        tail += data + struct.pack(">II", CHUNKS[name], len(data))
    return tail
