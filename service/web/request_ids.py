"""Each request has an id, its client's own or a new one: in its answer, its problem, and the log if it fails."""

import re
import uuid

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

HEADER = "X-Request-Id"
VALID = re.compile(r"[A-Za-z0-9._:/+=-]{1,128}")


def with_request_ids(app: ASGIApp) -> ASGIApp:
    """Give each request to `app` an id, and each of its answers the id of its request."""

    async def identified(scope: Scope, receive: Receive, send: Send) -> None:
        given = Headers(scope=scope).get(HEADER, "")
        request_id = given if VALID.fullmatch(given) else str(uuid.uuid4())
        scope.setdefault("state", {})["request_id"] = request_id

        async def send_with_id(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message)[HEADER] = request_id
            await send(message)

        await app(scope, receive, send_with_id)

    return identified


def request_id_of(request: Request) -> str:
    """Return the id of a request."""
    return str(request.state.request_id)
