"""Time from each request to the begin of its answer, as a histogram whose labels are bounded."""

import time
from collections.abc import Mapping
from typing import Any

from prometheus_client import Histogram
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.web.version import BASE

METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
OTHER = "other"
"""Label of a method that is none of these, and of an address that is no route's."""
LIMITS_S = (0.005, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0, 30.0)
"""Limits of the histogram; a long poll waits for up to 20 s by intent."""


class RequestTimes:
    """The histogram by method, template of the route, and class of the status."""

    def __init__(self) -> None:
        self.histogram = Histogram(
            "stonefall_http_request_seconds",
            "From a request to the begin of its answer",
            ["method", "route", "status"],
            registry=None,
            buckets=LIMITS_S,
        )

    def note(self, scope: Mapping[str, Any], status: int, took_s: float) -> None:
        """Add a request."""
        method = scope["method"] if scope["method"] in METHODS else OTHER
        route = getattr(scope.get("route"), "path", OTHER)
        if route != OTHER and scope["path"].startswith(BASE) and not route.startswith(BASE):
            route = BASE + route  # a route does not know the prefix that it was included with
        self.histogram.labels(method, route, f"{status // 100}xx").observe(took_s)


def timed(app: ASGIApp, times: RequestTimes) -> ASGIApp:
    """Return the application with its answers timed; an exception counts as status 500."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        begun_s, status = time.monotonic(), None

        async def send_noted(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start" and status is None:
                status = message["status"]
                times.note(scope, status, time.monotonic() - begun_s)
            await send(message)

        try:
            await app(scope, receive, send_noted)
        except Exception:
            if status is None:
                times.note(scope, 500, time.monotonic() - begun_s)
            raise

    return answer
