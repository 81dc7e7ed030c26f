"""What `stonefall bridge` does for MQTT: JSON topics, Sparkplug B or both, each over a connection of its own.

A result is delivered once the broker has acknowledged it; only then the cursor goes on. While there is no broker no
more is read: the daemon's feed is what stores and forwards.
"""

import asyncio

from service.base.abandonable import start_abandonable
from service.bridge.feeds import BridgeError
from service.bridge.mqtt.edge_node import EdgeNode
from service.bridge.mqtt.json_topics import JsonTopics
from service.bridge.mqtt.settings import MqttSettings
from service.bridge.plant import Plant
from service.bridge.reference_client import Position, keep_position

BATCH = 20
"""Results between two writes of the cursor: so many at most come twice when a kill falls between."""
Outlet = JsonTopics | EdgeNode


async def run(settings: MqttSettings, plant: Plant) -> None:
    """Publish until it is cancelled; raise `BridgeError` if cursor or settings cannot be used."""
    outlets: list[Outlet] = []
    if settings.prefix is not None:
        outlets.append(JsonTopics(settings, settings.prefix, plant))
    if settings.sparkplug is not None:
        outlets.append(EdgeNode(settings, settings.sparkplug, plant))
    try:
        async with asyncio.TaskGroup() as group:
            for outlet in outlets:
                group.create_task(outlet.keep())
                group.create_task(_deliver_all(plant, outlet))
    except* BridgeError as errors:
        error: BaseException = errors
        while isinstance(error, BaseExceptionGroup):
            error = error.exceptions[0]
        raise error from None


async def _deliver_all(plant: Plant, outlet: Outlet) -> None:
    """Deliver each result of the feed, a few at a time, and keep the cursor after each few."""
    cursor_file = plant.folder / outlet.name / "results.cursor"
    async for step in plant.results(outlet.name):
        if step.gap is not None:
            await outlet.tell_gap(step.gap)
        for begin in range(0, len(step.items), BATCH):
            batch = step.items[begin : begin + BATCH]
            await outlet.deliver(batch)
            reached = Position(step.position.instance_id, batch[-1]["seq"])
            await start_abandonable("keep cursor", keep_position, cursor_file, reached)
