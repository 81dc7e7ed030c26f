"""One HTTP request that posts a message, bounded in time and memory against any behaviour of the other side.

Only a listed host is connected to, at an address that is allowed; no redirect is followed, no proxy asked, and of the
answer nothing is read but its head.
"""

import asyncio
import ssl
import time
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from http import client
from socket import SOCK_STREAM, getaddrinfo

import h11

from service.base.addresses import address_of
from service.base.errors import ServiceError
from service.delivery.abandonable import start_abandonable
from service.delivery.progress import EndpointAnswer
from service.delivery.settings import WebhookEndpoint, WebhooksSettings

CHUNK_BYTES = 4096
MAX_HEAD_BYTES = 32 * 1024
"""Greatest head of an answer, with all interim answers before it."""
MAX_ADDRESSES = 4
"""Addresses of a name that are tried."""


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
            answer = await _answer(endpoint, settings, _request(endpoint, body, headers), tls)
    except TimeoutError:
        answer = EndpointAnswer(problem=f"no answer within {settings.timeout_s:g} s")
    except (NoAnswerError, OSError, ValueError) as err:
        answer = EndpointAnswer(problem=str(err) or type(err).__name__)
    return replace(answer, duration_ms=round(1000 * (time.monotonic() - began_s)))


def _request(endpoint: WebhookEndpoint, body: bytes, headers: Mapping[str, str]) -> list[h11.Event]:
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
    return [
        h11.Request(method="POST", target=target, headers=list(fields.items())),
        h11.Data(data=body),
        h11.EndOfMessage(),
    ]


async def _answer(
    endpoint: WebhookEndpoint,
    settings: WebhooksSettings,
    request: list[h11.Event],
    tls: ssl.SSLContext | None,
) -> EndpointAnswer:
    reader, writer = await _connect(endpoint, settings, tls)
    try:
        connection = h11.Connection(h11.CLIENT, max_incomplete_event_size=MAX_HEAD_BYTES)
        for part in request:
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
    host, port, addresses = endpoint.host, endpoint.port, await _addresses(endpoint)
    allowed = [each for each in addresses if settings.allows_address(host, each)][:MAX_ADDRESSES]
    if not allowed:
        raise NoAnswerError(
            f"{host} has the address {', '.join(addresses)}, not in [webhooks] allowed_networks: not asked"
        )
    share_s = settings.timeout_s / len(allowed) if len(allowed) > 1 else None
    refusal: OSError | None = None
    for address in allowed:
        try:
            async with asyncio.timeout(share_s):
                return await asyncio.open_connection(
                    address,
                    port,
                    limit=CHUNK_BYTES,
                    ssl=tls,
                    server_hostname=host if tls is not None else None,
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
