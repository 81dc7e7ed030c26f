"""The target of a request: a path, below the prefix of a proxy or not, or a whole address (RFC 9112, 3.2.2)."""

import re
from urllib.parse import unquote

from starlette.datastructures import MutableHeaders
from starlette.responses import RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.web.version import BASE

JOINED = re.compile(f"/+({BASE[1:]})/+(.+)".encode())
"""Path below an address that ends with a slash, to which a client has added paths that begin with one."""
ABSOLUTE = re.compile(rb"https?://(?P<netloc>[^/@]+)(?P<path>/.*)?", re.IGNORECASE)


def answering_whole_addresses(app: ASGIApp) -> ASGIApp:
    """Ask `app` for the path of a target such as `http://host:8080/api/v1/health`; its host replaces `Host`."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and (target := ABSOLUTE.fullmatch(scope["raw_path"])):
            others = [(name, value) for name, value in scope["headers"] if name != b"host"]
            _ask_for(scope, target["path"] or b"/")
            scope["headers"] = [(b"host", target["netloc"]), *others]
        await app(scope, receive, send)

    return answer


def answering_joined(app: ASGIApp) -> ASGIApp:
    """Ask `app` for the path of a target such as `/api/v1//results`.

    Slashes further behind stay: between two of them a client has left out a name.
    """

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and (target := JOINED.fullmatch(scope["raw_path"])):
            _ask_for(scope, b"/%b/%b" % target.groups())
        await app(scope, receive, send)

    return answer


def _ask_for(scope: Scope, raw_path: bytes) -> None:
    """Change the path in the request itself: what answers a failure outside has the same."""
    scope.update(raw_path=raw_path, path=unquote(raw_path.decode("ascii")))


def answering_below(app: ASGIApp, prefix: str) -> ASGIApp:
    """Ask `app` for paths below the prefix of a proxy, which may strip it, and put it before each `Location`."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        path: str = scope.get("path", "")
        if path == prefix:  # what a page names is relative to its folder
            await RedirectResponse(f"{prefix}/", 308)(scope, receive, send)
            return
        if path.startswith(f"{prefix}/"):
            raw_path = scope["raw_path"].removeprefix(prefix.encode())
            scope.update(path=path.removeprefix(prefix), raw_path=raw_path)

        async def send_with_prefix(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                if headers.get("location", "").startswith("/"):
                    headers["location"] = prefix + headers["location"]
            await send(message)

        await app(scope, receive, send_with_prefix)

    return answer
