"""Reject requests that foreign web pages make through a browser: by host name, origin and media type.

A browser in the plant shows pages of anybody, and reaches this service with its user's address. Without these checks a
page could write (a form needs no permission), and, when its own name leads to this service (DNS rebinding), also read.
"""

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from service.base.addresses import address_of, host_of, is_loopback
from service.web.problems import Problem, problem_response
from service.web.settings import ApiSettings

READING = frozenset({"GET", "HEAD", "OPTIONS"})
UNPACKED = frozenset({"identity", "", "utf-8", "utf8"})
"""Content codings of a body that is not compressed; some clients give that of its characters in this place."""


class ForeignPages:
    """ASGI middleware that answers 421, 403 or 415 to requests that no client of ours sends."""

    def __init__(self, app: ASGIApp, settings: ApiSettings) -> None:
        self._app = app
        self._bound = settings.host.lower()
        self._allowed = frozenset(name.lower() for name in settings.allowed_hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        request = Request(scope)
        problem = self._refusal(request)
        await (self._app if problem is None else problem_response(request, problem))(scope, receive, send)

    def _refusal(self, request: Request) -> Problem | None:
        netloc = request.headers.get("host")  # without one it is no browser
        if netloc is not None and not self._is_ours(host_of(netloc), request.scope.get("server")):
            detail = f"this service is not {netloc!r}: ask for its address, or list the name in [api] allowed_hosts"
            return Problem(421, "unknown-host", detail)
        if request.method in READING:
            return None
        origin = request.headers.get("origin")
        if origin is not None and not self._is_our_page(origin, netloc):
            detail = f"a page of {origin!r} must not change anything here; programs send no Origin"
            return Problem(403, "foreign-origin", detail)
        media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
        has_body = request.headers.get("content-length", "0") != "0" or "transfer-encoding" in request.headers
        if has_body and media_type != "application/json":
            detail = f"Content-Type must be application/json, not {media_type!r}"
            return Problem(415, "unsupported-media-type", detail)
        coding = request.headers.get("content-encoding", "identity")
        if has_body and coding.strip().lower() not in UNPACKED:
            detail = f"a body must not be compressed: Content-Encoding is {coding!r}"
            return Problem(415, "unsupported-media-type", detail, headers={"Accept-Encoding": "identity"})
        return None

    def _is_ours(self, host: str, server: tuple[str, int | None] | None) -> bool:
        """True when `host` is a name of this service, or the address to which the request came."""
        if is_loopback(host) or host == self._bound or host in self._allowed:
            return True
        # behind 0.0.0.0 there are several addresses, none of which can be rebound as a name can
        address = address_of(host)
        return address is not None and server is not None and address == address_of(server[0])

    def _is_our_page(self, origin: str, netloc: str | None) -> bool:
        """True when a page is from the very host and port that it asks, or from a host that is configured."""
        _, _, page = origin.lower().partition("://")
        return page != "" and (page == (netloc or "").lower() or host_of(page) in self._allowed)
