"""Modbus TCP server of the contacts and registers, which can be read and not written.

The server is our own, as it has so little to do: four functions that read. A frame is bounded by its standard, a client
by `idle_s`, and there are at most `max_clients`; one answer is sent before the next request is read.
[MODBUS Application Protocol V1.1b3; MODBUS Messaging on TCP/IP V1.0b]
"""

import asyncio
import logging
import struct
from collections.abc import Sequence

from service.base.addresses import is_loopback
from service.bridge.contacts.points import bits, registers
from service.bridge.contacts.settings import ModbusSettings
from service.bridge.plant import Plant

log = logging.getLogger(__name__)

HEADER = struct.Struct(">HHHB")
"""Transaction, protocol (0), bytes that follow with the unit, unit."""
REQUEST = struct.Struct(">BHH")
"""Function, first address, number of points."""
MAX_PDU = 253
READ_BITS, READ_WORDS = (1, 2), (3, 4)
"""Coils and discrete inputs, which are the same here; so are holding and input registers."""
MAX_BITS, MAX_WORDS = 2000, 125
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3


async def run(settings: ModbusSettings, plant: Plant) -> None:
    """Serve the registers until it is cancelled; raises `OSError` when the port cannot be had."""
    clients: set[asyncio.Task[None]] = set()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        if task is None or len(clients) == settings.max_clients:
            writer.transport.abort()
            return
        clients.add(task)
        try:
            while True:
                async with asyncio.timeout(settings.idle_s):
                    await _turn(reader, writer, plant)
        except (TimeoutError, OSError, asyncio.IncompleteReadError, ValueError) as err:
            log.debug("a client of Modbus is disconnected: %s", err)
        finally:
            clients.discard(task)
            writer.transport.abort()  # not close: it would wait for a client that reads nothing

    server = await asyncio.start_server(serve, settings.host, settings.port)
    log.info("modbus at %s", ", ".join("{}:{}".format(*each.getsockname()[:2]) for each in server.sockets))
    if not is_loopback(settings.host):
        log.warning("every host that reaches %s port %d reads the registers", settings.host, settings.port)
    try:
        await asyncio.Event().wait()
    finally:
        server.close()
        for task in clients:
            task.cancel()
        await asyncio.gather(*clients, return_exceptions=True)


async def _turn(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, plant: Plant) -> None:
    """Answer the next request; raise `ValueError` for what is no Modbus."""
    transaction, protocol, n_bytes, unit = HEADER.unpack(await reader.readexactly(HEADER.size))
    if protocol != 0 or not 2 <= n_bytes <= MAX_PDU + 1:
        raise ValueError(f"no frame of Modbus TCP: protocol {protocol}, {n_bytes} bytes")
    request = await reader.readexactly(n_bytes - 1)
    content = answer(request, bits(plant.state, plant.n_answers), registers(plant.state, plant.n_answers))
    writer.write(HEADER.pack(transaction, 0, len(content) + 1, unit) + content)
    await writer.drain()


def answer(request: bytes, coils: Sequence[bool], words: Sequence[int]) -> bytes:
    """Return the PDU that answers a request of 1 to 253 bytes: the points asked for, or an exception."""
    function = request[0]

    def refused(code: int) -> bytes:
        return bytes((function | 0x80, code))

    if function not in READ_BITS + READ_WORDS:
        return refused(ILLEGAL_FUNCTION)
    are_bits = function in READ_BITS
    points: Sequence[int] = coils if are_bits else words
    if len(request) != REQUEST.size:
        return refused(ILLEGAL_VALUE)
    _, first, n = REQUEST.unpack(request)
    if not 1 <= n <= (MAX_BITS if are_bits else MAX_WORDS):
        return refused(ILLEGAL_VALUE)
    if first + n > len(points):
        return refused(ILLEGAL_ADDRESS)
    asked = points[first : first + n]
    if are_bits:
        packed = sum(int(is_on) << place for place, is_on in enumerate(asked)).to_bytes(
            (n + 7) // 8, "little"
        )
    else:
        packed = struct.pack(f">{n}H", *asked)
    return bytes((function, len(packed))) + packed
