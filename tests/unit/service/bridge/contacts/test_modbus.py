"""Modbus TCP against a foreign client, and against what is no Modbus."""

import asyncio
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.client import AsyncModbusTcpClient
from support.bridge import overview

from service.bridge.contacts.modbus import answer, run
from service.bridge.contacts.points import BITS, LOT_WORDS, bits, registers
from service.bridge.contacts.settings import ModbusSettings
from service.bridge.plant import Plant
from service.bridge.plant_state import state_of

WELL = state_of(overview(), ())
N_WORDS = len(registers(WELL, 1))
READ = bytes.fromhex("0001 0000 0006 01 02 0000 0009")
"""Read all contacts."""


class ShownPlant(Plant):
    """A plant whose state is shown by the test."""

    def __init__(self) -> None:
        super().__init__("http://127.0.0.1:9", None, Path("unused"), None)
        self.show(state_of(overview(), ()))
        self.n_answers = 1

    show = Plant._show


@asynccontextmanager
async def serving(port: int, **settings: float) -> AsyncIterator[Plant]:
    """Serve a plant where all is well."""
    plant = ShownPlant()
    task = asyncio.create_task(run(ModbusSettings(port=port, **settings), plant))
    while True:
        with suppress(OSError):
            _, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.close()
            break
        await asyncio.sleep(0.01)
    try:
        yield plant
    finally:
        task.cancel()
        await asyncio.wait([task])


async def asked(port: int, request: bytes) -> bytes:
    """Return all that is answered until the server closes, or a whole answer is there."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(request)
    received = b""
    with suppress(OSError):
        while len(received) < 6 or len(received) < 6 + struct.unpack(">H", received[4:6])[0]:
            if not (chunk := await reader.read(1000)):
                break
            received += chunk
    writer.close()
    return received


async def test_a_foreign_client_reads_contacts_and_registers(unused_tcp_port: int) -> None:
    async with (
        serving(unused_tcp_port) as plant,
        AsyncModbusTcpClient("127.0.0.1", port=unused_tcp_port) as client,
    ):
        for read in (client.read_coils, client.read_discrete_inputs):
            found = await read(0, count=len(BITS))
            assert found.bits[: len(BITS)] == bits(plant.state, 1)
        for read in (client.read_holding_registers, client.read_input_registers):
            found = await read(0, count=N_WORDS)
            assert found.registers == registers(plant.state, 1)
            n_stones = client.convert_from_registers(
                (await read(11, count=2)).registers, client.DATATYPE.UINT32
            )
            assert n_stones == 70_000
        lot = (await client.read_input_registers(N_WORDS - LOT_WORDS, count=LOT_WORDS)).registers
        assert client.convert_from_registers(lot, client.DATATYPE.STRING) == "L-7"


async def test_writes_and_what_is_not_there_are_refused(unused_tcp_port: int) -> None:
    async with serving(unused_tcp_port) as plant:
        before = registers(plant.state, 1)
        async with AsyncModbusTcpClient("127.0.0.1", port=unused_tcp_port) as client:
            for written in (
                await client.write_coil(2, True),
                await client.write_register(4, 3),
                await client.write_registers(0, [1, 2]),
                await client.write_coils(0, [True]),
                await client.mask_write_register(address=0, and_mask=1, or_mask=1),
                await client.read_exception_status(),
            ):
                assert (written.isError(), written.exception_code) == (True, 1)
            assert (await client.read_input_registers(N_WORDS - 1, count=2)).exception_code == 2
            assert (await client.read_coils(500, count=1)).exception_code == 2
            assert (await client.read_input_registers(0, count=N_WORDS)).registers == before


@given(st.binary(min_size=1, max_size=253))
def test_any_request_has_an_answer_of_the_standard(request: bytes) -> None:
    found = answer(request, bits(WELL, 1), registers(WELL, 1))
    assert 2 <= len(found) <= 253
    if found[0] == request[0] & 0x7F:
        assert request[0] in (1, 2, 3, 4)
        assert found[1] == len(found) - 2
    else:
        assert found[0] == request[0] | 0x80
        assert found[1] in (1, 2, 3)


@pytest.mark.parametrize(
    "hostile",
    [
        bytes.fromhex("0001 0001 0006 01 02 0000 0009"),  # another protocol
        bytes.fromhex("0001 0000 0000 01"),  # no unit, no function
        bytes.fromhex("0001 0000 0001 01"),
        bytes.fromhex("0001 0000 ffff 01 02 0000 0009"),  # longer than a frame may be
        b"GET / HTTP/1.1\r\n\r\n",
        bytes(range(256)) * 16,
    ],
    ids=lambda frame: frame[:8].hex(),
)
async def test_what_is_no_modbus_is_disconnected_and_others_are_served(
    hostile: bytes, unused_tcp_port: int
) -> None:
    async with serving(unused_tcp_port):
        assert await asked(unused_tcp_port, hostile) == b""
        assert (await asked(unused_tcp_port, READ))[7] == 2


async def test_requests_that_come_together_or_in_pieces_are_each_answered(unused_tcp_port: int) -> None:
    async with serving(unused_tcp_port):
        reader, writer = await asyncio.open_connection("127.0.0.1", unused_tcp_port)
        requests = [struct.pack(">H", number) + READ[2:] for number in range(50)]
        writer.write(b"".join(requests[:-1]) + requests[-1][:5])
        await writer.drain()
        writer.write(requests[-1][5:])
        for number in range(50):
            frame = await reader.readexactly(7 + 2 + 2)
            assert struct.unpack(">H", frame[:2])[0] == number
        writer.close()


async def test_one_client_too_many_is_refused_and_an_idle_one_makes_room(unused_tcp_port: int) -> None:
    async with serving(unused_tcp_port, max_clients=2, idle_s=1):
        idle = []
        while len(idle) < 2:
            reader, writer = await asyncio.open_connection("127.0.0.1", unused_tcp_port)
            writer.write(READ)
            with suppress(OSError, asyncio.IncompleteReadError):  # that of `serving` may be there still
                await reader.readexactly(11)
                idle.append((reader, writer))
        assert await asked(unused_tcp_port, READ) == b""
        for reader, writer in idle:
            with suppress(OSError):
                assert await reader.read() == b""
            writer.close()
        assert (await asked(unused_tcp_port, READ))[7] == 2
