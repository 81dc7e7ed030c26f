"""One connection to the broker, on asyncio: from CONNECT to its end; after it another one is made.

MQTT 5, as a broker then says that it refuses a message; by 3.1.1 it acknowledges and drops it. Sparkplug
asks for Clean Start; another one may ask the broker to remember it, so that it is seen if the broker has forgotten.
"""

import asyncio
import ssl
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags, MQTTMessage, MQTTv5
from paho.mqtt.enums import CallbackAPIVersion, LogLevel, MQTTErrorCode
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from service.base.abandonable import start_abandonable
from service.bridge.feeds import BridgeError
from service.bridge.mqtt.settings import MqttSettings

MAX_IN_FLIGHT = 10
"""Messages of QoS 1 that wait for their acknowledgement: no common broker takes fewer (HiveMQ 10, mosquitto 20)."""
KEEPALIVE_S = 15
"""A broker that is silent for twice this time is gone."""
NO_SUBSCRIBERS = 0x10
"""Reason code of a PUBACK, MQTT 5, section 3.4.2.1."""
CONNECT_S, ACKNOWLEDGED_S, CLOSE_S = 10.0, 30.0, 5.0
SESSION_S = 3600
"""Time for which the broker is to remember a session."""
MAX_INCOMING_BYTES = 64 * 1024
"""The broker is asked to send no larger message."""


class BrokerError(BridgeError):
    """The broker does not answer, refuses, or is gone; says why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MqttMessage:
    """A message to the broker."""

    topic: str
    payload: bytes
    qos: int = 1
    is_retained: bool = False


Heard = Callable[[str, bytes], None]
"""Takes topic and payload of a message from the broker; called on the event loop."""


class ClosingSocket(ssl.SSLSocket):
    """A socket that a failed handshake closes: the library forgets it."""

    def do_handshake(self, block: bool = False) -> None:
        try:
            super().do_handshake(block)
        except BaseException:
            self.close()
            raise


class BrokerConnection:
    """A context: connected when it is entered, closed with its will published when it is left."""

    def __init__(
        self, settings: MqttSettings, client_id: str, will: MqttMessage, heard: Heard | None = None
    ) -> None:
        """With `heard` it is of Clean Start, and may subscribe."""
        self._settings, self._heard = settings, heard
        self.is_remembered = False
        """True when the broker has the session of the connection before: it was not started anew meanwhile."""
        self._loop = asyncio.get_running_loop()
        self._trouble = ""  # what the library says of it, such as an alert of TLS
        self.ended: asyncio.Future[None] = self._loop.create_future()
        """Has a `BrokerError` once the connection is gone."""
        self._connected: asyncio.Future[None] = self._loop.create_future()
        self._waiting: dict[int, tuple[str, asyncio.Future[bool]]] = {}  # for the acknowledgement of a packet
        self._starting = threading.Lock()
        self._is_left = False  # perhaps while it still connects, on a thread that nothing waits for
        self._client = client = Client(
            CallbackAPIVersion.VERSION2, client_id, protocol=MQTTv5, reconnect_on_failure=False
        )
        client.connect_timeout = CONNECT_S
        client.max_inflight_messages_set(MAX_IN_FLIGHT)
        client.will_set(will.topic, will.payload, will.qos, will.is_retained)
        # on the library's thread
        client.on_connect, client.on_disconnect = self._on_connect, self._on_disconnect
        client.on_publish, client.on_subscribe = self._on_publish, self._on_subscribe
        client.on_message, client.on_log = self._on_message, self._on_log

    async def __aenter__(self) -> Self:
        try:
            await start_abandonable("connect to broker", self._open)
            async with asyncio.timeout(CONNECT_S):
                await self._connected
        except ssl.SSLCertVerificationError as err:
            raise BrokerError(f"its certificate is refused: {err.verify_message}") from err
        except (OSError, ValueError, TimeoutError) as err:
            await self._close()
            raise BrokerError(str(err) or "no answer") from err
        except BaseException:
            await self._close()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._close()

    def send(self, message: MqttMessage) -> "asyncio.Future[bool]":
        """Send in the order of the calls; the future ends with the acknowledgement, or a `BrokerError`.

        It is false when the broker says that nothing subscribes to the topic. One of QoS 0 ends at once.
        """
        if self.ended.done():
            return self._sent(MQTTErrorCode.MQTT_ERR_NO_CONN, None, message.topic)
        info = self._client.publish(message.topic, message.payload, message.qos, message.is_retained)
        return self._sent(info.rc, info.mid if message.qos else None, message.topic)

    async def deliver(self, messages: Iterable[MqttMessage]) -> None:
        """Send messages and wait for all acknowledgements; raise `BrokerError` when one is missing."""
        await self.acknowledged([self.send(each) for each in messages])

    async def subscribe(self, topic: str, *, with_retained: bool = False) -> None:
        """Subscribe with QoS 1. All that was sent before is at the broker when this returns, of QoS 0 as well."""
        handling = (
            SubscribeOptions.RETAIN_SEND_ON_SUBSCRIBE
            if with_retained
            else SubscribeOptions.RETAIN_DO_NOT_SEND
        )
        code, number = self._client.subscribe(topic, options=SubscribeOptions(1, retainHandling=handling))
        await self.acknowledged([self._sent(code, number, topic)])

    async def acknowledged(self, sent: list["asyncio.Future[bool]"]) -> None:
        """Wait for acknowledgements; end the connection and raise `BrokerError` if one is late, or a refusal."""
        if not sent:
            return
        _, late = await asyncio.wait(sent, timeout=ACKNOWLEDGED_S, return_when=asyncio.FIRST_EXCEPTION)
        errors = [
            str(error) for future in sent if future.done() and (error := future.exception()) is not None
        ]
        if late or errors:
            self.end(reason := (errors or [f"no acknowledgement within {ACKNOWLEDGED_S:g} s"])[0])
            raise BrokerError(reason)

    def _sent(self, code: MQTTErrorCode, number: int | None, topic: str) -> "asyncio.Future[bool]":
        future: asyncio.Future[bool] = self._loop.create_future()
        future.add_done_callback(_retrieved)
        if code != MQTTErrorCode.MQTT_ERR_SUCCESS:
            future.set_exception(BrokerError("the connection is gone"))
        elif number is None:
            future.set_result(True)
        else:
            self._waiting[number] = (topic, future)
        return future

    def _open(self) -> None:
        settings, client = self._settings, self._client
        if (context := settings.tls_context()) is not None:
            context.sslsocket_class = ClosingSocket
            client.tls_set_context(context)
        if settings.user is not None:
            client.username_pw_set(settings.user, settings.password())
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]  # paho's has no types
        properties.SessionExpiryInterval = SESSION_S if self._heard is None else 0
        properties.MaximumPacketSize = MAX_INCOMING_BYTES
        properties.ReceiveMaximum = MAX_IN_FLIGHT
        client.connect(
            settings.host,
            settings.tcp_port,
            KEEPALIVE_S,
            clean_start=self._heard is not None,
            properties=properties,
        )
        with self._starting:
            if not self._is_left:
                client.loop_start()
        if self._is_left:
            client.reinitialise()  # closes the socket: nothing else will

    async def _close(self) -> None:
        # the will is published, though we go by intent: the one way out is that of a crash, too
        client = self._client
        with self._starting:
            self._is_left = True
        client.disconnect(ReasonCode(PacketTypes.DISCONNECT, "Disconnect with will message"))
        self.end("closed")
        with suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_S):
                await start_abandonable("leave broker", client.loop_stop)
        client.reinitialise()  # closes the sockets that wake its thread: by itself it does so when it is collected

    def end(self, reason: str) -> None:
        """End it: what waits has a `BrokerError` with the reason."""
        waiting: list[asyncio.Future[Any]] = [future for _, future in self._waiting.values()]
        for future in (self._connected, self.ended, *waiting):
            if not future.done():
                future.set_exception(BrokerError(reason))
                _retrieved(future)
        self._waiting.clear()

    def _begin(self, is_remembered: bool) -> None:
        self.is_remembered = is_remembered
        if not self._connected.done():
            self._connected.set_result(None)

    def _acknowledge(self, number: int, reasons: list[ReasonCode]) -> None:
        topic, future = self._waiting.pop(number, ("", None))
        if future is None or future.done():
            return
        if refusals := [str(reason) for reason in reasons if reason.is_failure]:
            future.set_exception(BrokerError(f"it refuses {topic}: {', '.join(refusals)}"))
        else:
            future.set_result(NO_SUBSCRIBERS not in [reason.value for reason in reasons])

    # --- on the library's thread ---

    def _on_connect(
        self, client: Client, _: Any, flags: ConnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        if reason.is_failure:
            self._soon(self.end, f"it refuses the connection: {reason}")
        else:
            self._soon(self._begin, flags.session_present)

    def _on_disconnect(
        self,
        client: Client,
        _: Any,
        flags: DisconnectFlags,
        reason: ReasonCode,
        properties: Properties | None,
    ) -> None:
        told = (
            f"it ends the connection: {reason}"
            if flags.is_disconnect_packet_from_server
            else "the connection is lost"
        )
        self._soon(self.end, f"{told} ({self._trouble})" if self._trouble else told)

    def _on_publish(
        self, client: Client, _: Any, number: int, reason: ReasonCode, properties: Properties
    ) -> None:
        self._soon(self._acknowledge, number, [reason])

    def _on_subscribe(
        self, client: Client, _: Any, number: int, reasons: list[ReasonCode], properties: Properties | None
    ) -> None:
        self._soon(self._acknowledge, number, reasons)

    def _on_message(self, client: Client, _: Any, message: MQTTMessage) -> None:
        with suppress(UnicodeDecodeError):  # a topic that is no text is none of ours
            if self._heard is not None:
                self._soon(self._heard, message.topic, bytes(message.payload))

    def _on_log(self, client: Client, _: Any, level: int, text: str) -> None:
        if level == LogLevel.MQTT_LOG_ERR:
            self._trouble = text

    def _soon(self, call: Callable[..., None], *arguments: Any) -> None:
        with suppress(RuntimeError):  # the loop is closed: the process ends
            self._loop.call_soon_threadsafe(call, *arguments)


def _retrieved(future: "asyncio.Future[Any]") -> None:
    """Mark the exception of a future as seen: that nothing waits for it is no mistake."""
    if future.done() and not future.cancelled():
        future.exception()
