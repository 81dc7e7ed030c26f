"""The plain JSON topics of one broker: each result once, and the present state retained."""

import asyncio
import json
import logging
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import compress
from operator import not_
from pathlib import Path
from typing import Any

from service.bridge.feeds import BridgeError
from service.bridge.mqtt.connection import BrokerConnection, BrokerError, MqttMessage
from service.bridge.mqtt.link import Link, pause_s
from service.bridge.mqtt.settings import MqttSettings
from service.bridge.mqtt.topics import (
    Document,
    gap_message,
    result_message,
    retained,
    retained_message,
    status_message,
)
from service.bridge.plant import Plant
from service.bridge.reference_client import Gap

log = logging.getLogger(__name__)

MAX_CHECKS = 500
RECENT_S, MAX_RECENT = 10.0, 1000
"""Results that a broker may have had in memory alone: a subscriber that is connected has them within this time."""


class JsonTopics:
    """Publishes below a prefix. `keep` it running."""

    name = "mqtt"

    def __init__(self, settings: MqttSettings, prefix: str, plant: Plant) -> None:
        self._prefix, self._plant = prefix, plant
        self._checks_file = plant.folder / self.name / "alarms.json"
        self._checks = _kept_checks(self._checks_file)
        self._waits_for_subscriber = settings.waits_for_subscriber
        self._recent: dict[MqttMessage, float] = {}  # acknowledged, with the time, the oldest first
        self._has_forgotten = asyncio.Event()
        will = status_message(prefix, "offline")
        self._link: Link[BrokerConnection] = Link(
            f"{settings.host} {prefix}", lambda: BrokerConnection(settings, settings.client_id, will)
        )

    async def keep(self) -> None:
        """Keep connected until it is cancelled."""
        async with asyncio.TaskGroup() as group:
            group.create_task(self._link.keep(self._serve))
            group.create_task(self._repeat())

    async def deliver(self, results: Sequence[Mapping[str, Any]]) -> None:
        """Return once the broker has acknowledged all of them."""
        await self._send([result_message(self._prefix, result) for result in results])

    async def _repeat(self) -> None:
        """Send the newest results again whenever the broker was started anew: it may have lost what it acknowledged."""
        while True:
            await self._has_forgotten.wait()
            self._has_forgotten.clear()
            await self._send(list(self._recent))

    async def tell_gap(self, gap: Gap) -> None:
        """Tell that results were removed before they were read."""
        await self._send([gap_message(self._prefix, vars(gap))])

    async def _serve(self, connection: BrokerConnection) -> None:
        """Set all that is retained anew, then what changes."""
        told: dict[str, Document] = {}
        if not connection.is_remembered:
            self._has_forgotten.set()
        await connection.deliver([status_message(self._prefix, "online")])
        async for now in self._plant.states():
            self._remember(alarm.check for alarm in now.alarms)
            documents = retained(now, self._checks)
            changed = {topic: each for topic, each in documents.items() if told.get(topic) != each}
            await connection.deliver(
                retained_message(self._prefix, topic, document, now.at) for topic, document in changed.items()
            )
            if not told:
                self._link.open(connection)
            told = documents

    async def _send(self, messages: list[MqttMessage]) -> None:
        """Send until each is acknowledged, over as many connections as it takes; what nothing subscribes to waits.

        A broker that was started again may have lost its subscriptions: it would acknowledge, and drop.
        """
        n_unheard = 0
        while messages:
            connection = await self._link.sender()
            tried = messages[:1] if n_unheard else messages
            sent = [connection.send(message) for message in tried]
            with suppress(BrokerError):
                await connection.acknowledged(sent)
            is_heard = [
                future.exception() is None and (future.result() or not self._waits_for_subscriber)
                for future in sent
            ]
            self._keep_recent(compress(tried, is_heard))
            messages = list(compress(tried, map(not_, is_heard))) + messages[len(tried) :]
            if all(is_heard) or any(future.exception() is not None for future in sent):
                n_unheard = 0
                continue
            if not n_unheard:
                log.warning("nothing subscribes to %s: it waits until something does", messages[0].topic)
            await asyncio.sleep(pause_s(n_unheard))
            n_unheard += 1

    def _keep_recent(self, acknowledged: Iterable[MqttMessage]) -> None:
        now_s = time.monotonic()
        for message in acknowledged:
            self._recent.pop(message, None)
            self._recent[message] = now_s
        for message, time_s in list(self._recent.items()):
            if time_s >= now_s - RECENT_S and len(self._recent) <= MAX_RECENT:
                break
            del self._recent[message]

    def _remember(self, checks: Iterable[str]) -> None:
        """Keep the checks whose alarms are retained at the broker: one may end while no bridge runs."""
        if new := [check for check in checks if check not in self._checks]:
            self._checks = [*self._checks, *new][-MAX_CHECKS:]
            try:
                self._checks_file.parent.mkdir(parents=True, exist_ok=True)
                self._checks_file.write_text(json.dumps(self._checks))
            except OSError as err:
                raise BridgeError(f"{self._checks_file}: {err.strerror}") from err


def _kept_checks(file: Path) -> list[str]:
    try:
        return [str(check) for check in json.loads(file.read_text())]
    except FileNotFoundError:
        return []
    except (OSError, ValueError, TypeError) as err:
        log.warning("%s is not read (%s): alarms that ended meanwhile may stay at the broker", file, err)
        return []
