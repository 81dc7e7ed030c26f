"""The message of a webhook, signed as standardwebhooks.com has it, and the HTTP request that posts it.

A message is {type, timestamp, data}, and an id that is the same on every attempt; its signature is HMAC-SHA256 by a
shared secret. The request is bounded in time and memory against any behaviour of the other side.

Only a listed host is connected to, at an address that is allowed; no redirect is followed, no proxy asked, and of the
answer nothing is read but its head.
"""

import asyncio
import base64
import hashlib
import hmac
import json
import ssl
import time
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from http import client
from socket import SOCK_STREAM, getaddrinfo
from typing import Any

import h11

from service.base.abandonable import start_abandonable
from service.base.addresses import address_of
from service.base.errors import ServiceError
from service.delivery.progress import EndpointAnswer
from service.delivery.settings import WebhookEndpoint, WebhooksSettings

MAX_BYTES = 20_000
"""Smallest message that comes without its details."""
TEST = "webhook.test"
CHUNK_BYTES = 4096
MAX_HEAD_BYTES = 32 * 1024
"""Greatest head of an answer, with all interim answers before it."""
MAX_ADDRESSES = 4
"""Addresses of a name that are tried."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """A message, ready to be signed."""

    id: str
    type: str
    event: int | None  # its number; None for a test
    body: bytes


def message_of(event: Mapping[str, Any], instance_id: str) -> Message:
    """Return the message of an event as the feed has it; one that is too large comes without its details."""
    told = [event["seq"], event["at"], event["type"], event["subject"]]
    # not of the instance: that is another one after a restored backup, and the event the same
    digest = hashlib.sha256(json.dumps(told).encode()).hexdigest()[:16]
    body = _body(event, instance_id, event["data"])
    if len(body) >= MAX_BYTES:
        body = _body(event, instance_id, None)
    return Message(id=f"event-{event['seq']}-{digest}", type=event["type"], event=event["seq"], body=body)


def trial_message(instance_id: str, at: str) -> Message:
    """Return a message without an event, to test an endpoint."""
    event = {"seq": None, "at": at, "type": TEST, "subject": "test"}
    return Message(id=f"test-{uuid.uuid4()}", type=TEST, event=None, body=_body(event, instance_id, {}))


def _body(event: Mapping[str, Any], instance_id: str, details: Mapping[str, Any] | None) -> bytes:
    data = {"instance_id": instance_id, "seq": event["seq"], "subject": event["subject"], "details": details}
    document = {"type": event["type"], "timestamp": event["at"], "data": data}
    return json.dumps(document, ensure_ascii=False, separators=(",", ":")).encode("utf-8", "replace")


def signatures(keys: Iterable[bytes], message_id: str, timestamp_s: int, body: bytes) -> str:
    """Return the header `webhook-signature`: one signature for each key, during a rotation of secrets two."""
    signed = f"{message_id}.{timestamp_s}.".encode() + body
    digests = (hmac.digest(key, signed, hashlib.sha256) for key in keys)
    return " ".join(f"v1,{base64.b64encode(digest).decode()}" for digest in digests)


class NoAnswerError(ServiceError):
    """The endpoint cannot be asked, or has not answered as HTTP has it."""


async def post(
    endpoint: WebhookEndpoint,
    settings: WebhooksSettings,
    body: bytes,
    headers: Mapping[str, str],
    tls: ssl.SSLContext | None,
) -> EndpointAnswer:
    """Post a message and return the outcome; raises nothing."""
    began_s = time.monotonic()
    try:
        async with asyncio.timeout(settings.timeout_s):
            answer = await _answer(endpoint, settings, body, headers, tls)
    except TimeoutError:
        answer = EndpointAnswer(problem=f"no answer within {settings.timeout_s:g} s")
    except (NoAnswerError, OSError, ValueError) as err:
        answer = EndpointAnswer(problem=str(err) or type(err).__name__)
    return replace(answer, duration_ms=round(1000 * (time.monotonic() - began_s)))


async def _answer(
    endpoint: WebhookEndpoint,
    settings: WebhooksSettings,
    body: bytes,
    headers: Mapping[str, str],
    tls: ssl.SSLContext | None,
) -> EndpointAnswer:
    parts = endpoint.target
    target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    fields = {
        "Host": parts.netloc,
        "Content-Type": "application/json",
        "Content-Length": str(len(body)),
        "User-Agent": "stonefall",
        "Connection": "close",
        **headers,
    }
    request = h11.Request(method="POST", target=target, headers=list(fields.items()))
    reader, writer = await _connect(endpoint, settings, tls)
    try:
        connection = h11.Connection(h11.CLIENT, max_incomplete_event_size=MAX_HEAD_BYTES)
        for part in (request, h11.Data(data=body), h11.EndOfMessage()):
            writer.write(connection.send(part) or b"")
        return _answer_of(await _head(reader, connection))
    except h11.ProtocolError as err:
        raise NoAnswerError(f"the answer is not HTTP: {err}") from err
    finally:
        writer.transport.abort()  # a farewell could be waited for for ever


async def _connect(
    endpoint: WebhookEndpoint, settings: WebhooksSettings, tls: ssl.SSLContext | None
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Connect to the first allowed address that takes a connection."""
    host, port = endpoint.host, endpoint.port
    if not settings.allows_host(host):  # any more: the configuration may have changed since it was defined
        raise NoAnswerError(f"{host} is not in [webhooks] allowed_hosts: not asked")
    addresses = await _addresses(endpoint)
    allowed = [each for each in addresses if settings.allows_address(host, each)][:MAX_ADDRESSES]
    if not allowed:
        raise NoAnswerError(
            f"{host} has the address {', '.join(addresses)}, not in [webhooks] allowed_networks: not asked"
        )
    share_s = settings.timeout_s / len(allowed) if len(allowed) > 1 else None
    certified = None if tls is None else host
    refusal: OSError | None = None
    for address in allowed:
        try:
            async with asyncio.timeout(share_s):
                return await asyncio.open_connection(
                    address, port, limit=CHUNK_BYTES, ssl=tls, server_hostname=certified
                )
        except OSError as err:
            refusal = err
    raise NoAnswerError(f"no connection to {host}: {_reason(refusal)}")


async def _addresses(endpoint: WebhookEndpoint) -> list[str]:
    host = endpoint.host
    if address_of(host) is not None:
        return [host]
    try:
        found = await start_abandonable(
            f"name of {endpoint.name}", getaddrinfo, host, endpoint.port, 0, SOCK_STREAM
        )
    except (OSError, UnicodeError) as err:
        raise NoAnswerError(f"{host} has no address: {_reason(err)}") from err
    return list(dict.fromkeys(str(address[0]) for *_, address in found))


async def _head(reader: asyncio.StreamReader, connection: h11.Connection) -> h11.Response:
    """Return the head of the answer, and read no further."""
    n_bytes = 0
    while True:
        match connection.next_event():
            case h11.Response() as response:
                return response
            case h11.NEED_DATA:
                if n_bytes > MAX_HEAD_BYTES:
                    raise NoAnswerError(f"the head of the answer is longer than {MAX_HEAD_BYTES} bytes")
                received = await reader.read(CHUNK_BYTES)
                n_bytes += len(received)
                connection.receive_data(received)
            case h11.InformationalResponse():
                pass
            case _:
                raise NoAnswerError("the connection was closed without an answer")


def _answer_of(response: h11.Response) -> EndpointAnswer:
    status = response.status_code
    if 200 <= status < 300:
        return EndpointAnswer(status=status)
    problem = f"HTTP {status} {client.responses.get(status, '')}".rstrip()
    if 300 <= status < 400:
        problem += ": redirects are not followed"
    retry_after = dict(response.headers).get(b"retry-after", b"").decode("latin-1")
    retry_after_s = _seconds(retry_after, datetime.now(UTC))
    return EndpointAnswer(status=status, problem=problem, retry_after_s=retry_after_s)


def _seconds(retry_after: str, now: datetime) -> float | None:
    """Return the seconds that a header `Retry-After` asks for, as number or as date; None if it does not."""
    if retry_after.isdecimal() and len(retry_after) < 10:
        return float(retry_after)
    try:
        until = parsedate_to_datetime(retry_after)
        return (until - now).total_seconds()
    except (ValueError, TypeError, OverflowError):  # TypeError: a date without an offset
        return None


def _reason(error: BaseException | None) -> str:
    if isinstance(error, TimeoutError):
        return "no answer"
    strerror = getattr(error, "strerror", None)
    return str(strerror or error)
