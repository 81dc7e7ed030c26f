"""The target of a request may be a whole address, as to a proxy: it is answered as its path (RFC 9112, 3.2.2)."""

import re
from urllib.parse import unquote

from starlette.types import ASGIApp, Receive, Scope, Send

ABSOLUTE = re.compile(rb"https?://(?P<netloc>[^/@]+)(?P<path>/.*)?", re.IGNORECASE)


def answering_whole_addresses(app: ASGIApp) -> ASGIApp:
    """Ask `app` for the path of a target such as `http://host:8080/api/v1/health`; its host replaces `Host`."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and (target := ABSOLUTE.fullmatch(scope["raw_path"])):
            raw_path = target["path"] or b"/"
            others = [(name, value) for name, value in scope["headers"] if name != b"host"]
            scope = {
                **scope,
                "raw_path": raw_path,
                "path": unquote(raw_path.decode("ascii")),
                "headers": [(b"host", target["netloc"]), *others],
            }
        await app(scope, receive, send)

    return answer
