"""The edge node of Sparkplug B at one broker: it waits for its primary host, is born, and born again when asked."""

import asyncio
import logging
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from service.bridge.feeds import BridgeError
from service.bridge.mqtt.connection import BrokerConnection, BrokerError, MqttMessage
from service.bridge.mqtt.link import Link
from service.bridge.mqtt.settings import MqttSettings, SparkplugSettings
from service.bridge.mqtt.sparkplug import N_NUMBERS, Node, host_state, state_topic
from service.bridge.plant import Plant
from service.bridge.plant_state import PlantState
from service.bridge.reference_client import Gap

log = logging.getLogger(__name__)

REBIRTH_EVERY_S = 1.0
"""Least time between births that commands ask for: a flood of commands has one birth in this time."""


class EdgeNode:
    """Publishes as an edge node with one device. `keep` it running; all of it is on the event loop."""

    name = "sparkplug"

    def __init__(self, settings: MqttSettings, place: SparkplugSettings, plant: Plant) -> None:
        self._settings, self._place, self._plant = settings, place, plant
        self._number_file = plant.folder / self.name / "bdseq"
        self._node = Node(place, 0)
        self._now = PlantState()
        self._last_result: Mapping[str, Any] | None = None
        self._host_topic = None if place.primary_host is None else state_topic(place.primary_host)
        self._is_host_online = asyncio.Event()
        self._host_ms = 0  # time stamp of what the primary host said last
        self._connection: BrokerConnection | None = None
        self._rebirth: asyncio.TimerHandle | None = None
        self._born_s = 0.0  # by the monotonic clock; 0 before the birth of this connection
        self._has_told = False
        self._link: Link[BrokerConnection] = Link(
            f"{settings.host} {place.group}/{place.node}", self._connect
        )

    async def keep(self) -> None:
        """Keep connected until it is cancelled."""
        await self._link.keep(self._serve)

    async def deliver(self, results: Sequence[Mapping[str, Any]]) -> None:
        """Return once the broker has all of them: a subscription after data of QoS 0 is acknowledged in its place."""
        is_sent = False
        while not is_sent:
            connection = await self._link.sender()
            with suppress(BrokerError):
                _send(connection, [self._node.result(each, _now_ms()) for each in results])
                await connection.subscribe(self._node.command_topic)
                self._last_result, is_sent = results[-1], True

    async def tell_gap(self, gap: Gap) -> None:
        """Say nothing more: the log has it, and Sparkplug no word for it."""

    def _connect(self) -> BrokerConnection:
        """Make a connection with the next number of births; the number outlives a restart."""
        try:
            self._number_file.parent.mkdir(parents=True, exist_ok=True)
            number = (_number(self._number_file) + 1) % N_NUMBERS
            self._number_file.write_text(str(number))
        except OSError as err:
            raise BridgeError(f"{self._number_file}: {err.strerror}") from err
        self._node, self._born_s = Node(self._place, number), 0.0
        client_id = f"{self._settings.client_id}-sparkplug"
        return BrokerConnection(self._settings, client_id, self._node.death(), self._hear)

    async def _serve(self, connection: BrokerConnection) -> None:
        self._connection = connection
        self._is_host_online.clear()
        await connection.subscribe(self._node.command_topic)
        if self._host_topic is not None:
            await connection.subscribe(self._host_topic, with_retained=True)
            await self._is_host_online.wait()
        self._now = self._plant.state
        self._bear()
        try:
            async for now in self._plant.states():
                self._show(connection, now)
        finally:
            if self._rebirth is not None:
                self._rebirth.cancel()
                self._rebirth = None

    def _show(self, connection: BrokerConnection, now: PlantState) -> None:
        """Publish changes since the last state; the device is dead while the daemon does not answer."""
        self._now, node = now, self._node
        if now.daemon_answers and node.is_device_alive:
            _send(connection, node.changes(now, _now_ms()))
        elif now.daemon_answers:
            _send(connection, [node.device_birth(now, _now_ms(), self._last_result)])
        elif node.is_device_alive:
            _send(connection, [node.device_death(_now_ms())])
        if node.is_device_alive:
            self._link.open(connection)
        else:
            self._link.shut()

    def _bear(self) -> None:
        self._rebirth, self._born_s = None, time.monotonic()
        if self._connection is not None:
            _send(self._connection, self._node.births(self._now, _now_ms(), self._last_result))

    # --- what comes from others ---

    def _hear(self, topic: str, payload: bytes) -> None:
        try:
            if topic == self._node.command_topic:
                self._obey(payload)
            elif topic == self._host_topic:
                self._heed(*host_state(payload))
        except ValueError as err:
            if not self._has_told:
                self._has_told = True
                log.warning("%s: ignored, as it %s; others are ignored without a word", topic, err)

    def _obey(self, command: bytes) -> None:
        """Be born again if the command says so; nothing else can be ordered, and nothing is not born yet."""
        is_asked = self._node.asks_rebirth(command)
        if is_asked and self._born_s and self._rebirth is None:
            pause_s = max(self._born_s + REBIRTH_EVERY_S - time.monotonic(), 0)
            self._rebirth = asyncio.get_running_loop().call_later(pause_s, self._bear)

    def _heed(self, is_online: bool, host_ms: int) -> None:
        """Go on when the primary host is there, leave when it is not; what it said before it was last here is old."""
        if host_ms < self._host_ms:
            return
        self._host_ms = host_ms
        if is_online:
            self._is_host_online.set()
        elif self._is_host_online.is_set() and self._connection is not None:
            self._connection.end("the primary host is offline")


def _send(connection: BrokerConnection, messages: Sequence[MqttMessage]) -> None:
    for message in messages:
        connection.send(message)


def _number(file: Path) -> int:
    try:
        return int(file.read_text()) % N_NUMBERS
    except (OSError, ValueError):
        return -1


def _now_ms() -> int:
    return time.time_ns() // 1_000_000
