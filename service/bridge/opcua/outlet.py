"""Serve the plant over OPC UA: variables, events of results and alarms, and methods that give the daemon orders."""

import asyncio
import logging
import socket
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime
from typing import Any

from asyncua import ua

from service.bridge.opcua.access import Access
from service.bridge.opcua.alarms import PlantConditions
from service.bridge.opcua.bounded_server import BoundedServer
from service.bridge.opcua.certificates import OwnCertificate, now_utc, own_certificate
from service.bridge.opcua.log_pace import bound_library_log
from service.bridge.opcua.methods import MethodTable
from service.bridge.opcua.nodes import SHOWN, Shown, add_shown, add_variable, data_value, with_value
from service.bridge.opcua.plant_methods import plant_methods
from service.bridge.opcua.results import (
    LEAN,
    POSITION,
    add_result_type,
    latest,
    lean_value,
    result_event,
)
from service.bridge.opcua.settings import OpcUaSettings
from service.bridge.opcua.space import INDEX, NAMESPACE, Space
from service.bridge.plant import Plant
from service.bridge.plant_state import PlantState
from service.bridge.reference_client import Position, kept_position

log = logging.getLogger(__name__)

LATEST = tuple(latest())


async def run(settings: OpcUaSettings, plant: Plant) -> None:
    """Serve until cancelled; with a new certificate when the old one is soon at its end."""
    bound_library_log()
    host = socket.gethostname()
    uri = settings.application_uri or f"urn:{host}:stonefall:bridge"
    folder = plant.folder / "opcua"
    while True:
        own = await asyncio.to_thread(own_certificate, folder, uri, host, now_utc())
        outlet = OpcUaOutlet(plant, Access(folder, settings.users))
        await outlet.start(settings, uri, own)
        tasks = [asyncio.create_task(outlet.show()), asyncio.create_task(outlet.send())]
        try:
            left_s = (own.renewal_at - now_utc()).total_seconds()
            done, _ = await asyncio.wait(tasks, timeout=left_s, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await outlet.stop()
        for task in done:
            task.result()


class OpcUaOutlet:
    """The server of a plant."""

    def __init__(self, plant: Plant, access: Access) -> None:
        self._plant = plant
        self._methods = MethodTable()
        self._conditions = PlantConditions()
        self.access, self.server = access, BoundedServer(access, self._methods)

    async def start(self, settings: OpcUaSettings, uri: str, own: OwnCertificate) -> None:
        """Build the address space and listen; raise `OSError` if that cannot be."""
        server = self.server
        await server.init()
        server.set_server_name("stonefall")
        server.product_uri = NAMESPACE
        host = f"[{settings.host}]" if ":" in settings.host else settings.host
        server.set_endpoint(f"opc.tcp://{host}:{settings.port}/stonefall")
        await server.set_application_uri(uri)
        await server.set_build_info(NAMESPACE, "stonefall", "stonefall bridge", "", "", now_utc())
        if await server.register_namespace(NAMESPACE) != INDEX:
            raise RuntimeError("the namespace has another index")
        server.iserver.certificate, server.iserver.private_key = own.certificate, own.key
        space = Space(server)
        await add_shown(space)
        for shown in (*POSITION, *LATEST):
            await add_variable(space, shown)
        await add_result_type(space)
        for method in plant_methods(self._plant, self._conditions, server):
            await self._methods.add(space, method)
        waiting = ua.StatusCode(ua.StatusCodes.BadWaitingForInitialData)
        await self._write({each: ua.DataValue(ua.Variant(None), waiting) for each in (*POSITION, *LATEST)})
        with suppress(OSError, ValueError, TypeError):  # who follows the results says so
            kept = kept_position(self._plant.folder / "opcua" / "results.cursor")
            if kept.instance_id is not None:
                await self._show_position(kept)
        await self._show_state(self._plant.state)
        await server.start()
        log.info("opc ua: opc.tcp://%s:%d/stonefall", host, self.port)

    async def stop(self) -> None:
        """Close all connections."""
        await self.server.stop()

    @property
    def port(self) -> int:
        """Port that it listens at, 0 while it does not."""
        return 0 if self.server.bserver is None else int(self.server.bserver.port)

    async def show(self) -> None:
        """Show each state of the plant, until cancelled."""
        async for state in self._plant.states():
            await self._show_state(state)
            for event in self._conditions.follow(state):
                await self.server.emit(event)

    async def send(self) -> None:
        """Send each result as an event, until cancelled."""
        async for step in self._plant.results("opcua"):
            is_heard = bool(self.server.iserver.subscription_service.subscriptions)
            for result in step.items if is_heard else ():
                await self.server.emit(result_event(result, str(step.position.instance_id)))
                await asyncio.sleep(0)  # a step may have a thousand: clients have their turns between them
            if step.items:
                await self._show_latest(step.items[-1])
            await self._show_position(step.position)

    async def _show_state(self, state: PlantState) -> None:
        now = now_utc()
        await self._write({shown: data_value(shown, state, now) for shown in SHOWN})

    async def _show_position(self, position: Position) -> None:
        values = (position.instance_id, position.after)
        now = now_utc()
        await self._write(
            {shown: with_value(value, shown, now) for shown, value in zip(POSITION, values, strict=True)}
        )

    async def _show_latest(self, result: Mapping[str, Any]) -> None:
        at = datetime.fromisoformat(result["recorded_at"])
        values = {}
        for shown, name in zip(LATEST, LEAN, strict=True):
            value = lean_value(result, name)
            unknown = ua.DataValue(
                ua.Variant(None), ua.StatusCode(ua.StatusCodes.BadNoData), SourceTimestamp=at
            )
            values[shown] = unknown if value is None else with_value(value, shown, at)
        await self._write(values)

    async def _write(self, values: Mapping[Shown, ua.DataValue]) -> None:
        params = ua.WriteParameters()
        params.NodesToWrite = [
            ua.WriteValue(NodeId=shown.node, AttributeId=ua.AttributeIds.Value, Value=value)
            for shown, value in values.items()
        ]
        for shown, status in zip(values, await self.server.iserver.isession.write(params), strict=True):
            if not status.is_good():
                raise RuntimeError(f"{shown.path} cannot be {values[shown]}: {status}")
