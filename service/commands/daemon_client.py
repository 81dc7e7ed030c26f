"""A small client of the REST interface, for the commands that talk to a running daemon."""

import json
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from http.client import HTTPException
from typing import Annotated, Any
from urllib.parse import urlencode, urlsplit

import typer

from service.base.errors import ServiceError
from service.web.version import BASE

TIMEOUT_S = 30.0
LOOPBACK = ("127.0.0.1", "localhost", "::1")

DEFAULT_URL = "http://127.0.0.1:8080"

Url = Annotated[str, typer.Option(help="Address of the daemon.", envvar="STONEFALL_URL")]
ConfiguredUrl = Annotated[
    str | None, typer.Option(help="Address of the daemon; default: as [api] says.", envvar="STONEFALL_URL")
]
Key = Annotated[
    str | None,
    typer.Option(
        help="Token of a key, if the daemon requires one.", envvar="STONEFALL_KEY", show_envvar=True
    ),
]
Body = Mapping[str, Any] | None
AsJson = Annotated[bool, typer.Option("--json", help="Print the daemon's answer as JSON.")]


class DaemonError(ServiceError):
    """The daemon cannot be reached, or refuses a request: then `kind` is the last part of the problem's type."""

    def __init__(self, detail: str, kind: str | None = None) -> None:
        super().__init__(detail)
        self.kind = kind


@dataclass(frozen=True, slots=True)
class DaemonClient:
    """A running daemon, and the options that name it."""

    url: Url = DEFAULT_URL
    key: Key = None

    def ask(
        self, path: str, body: Body = None, *, method: str | None = None, timeout_s: float = TIMEOUT_S
    ) -> dict[str, Any]:
        """Return the answer to a GET request, or with a `body` to a POST request; members that are None are not sent.

        Raises `DaemonError` with its reason if the daemon does not answer, or refuses.
        """
        content = self.fetch(path, body, method=method, timeout_s=timeout_s)
        try:
            return dict(json.loads(content))
        except ValueError as err:
            raise self._silence(err) from None

    def pages(self, path: str, query: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
        """Yield the items of a list, page by page; raise `DaemonError` as `ask` does."""
        cursor: dict[str, str] | None = {}
        while cursor is not None:
            page = self.ask(f"{path}?{urlencode({**query, **cursor})}")
            yield from page["items"]
            cursor = None if page["next_cursor"] is None else {"cursor": page["next_cursor"]}

    def fetch(
        self, path: str, body: Body = None, *, method: str | None = None, timeout_s: float = TIMEOUT_S
    ) -> bytes:
        """Return the content of an answer, undecoded; otherwise as `ask`."""
        if urlsplit(self.url).scheme not in ("http", "https"):
            raise DaemonError(f"--url {self.url}: must begin with http:// or https://")
        headers = {"User-Agent": "stonefall"}
        data = None
        if body is not None:
            headers["Content-Type"] = "application/json"
            data = json.dumps({name: value for name, value in body.items() if value is not None}).encode()
        if self.key is not None:
            headers["Authorization"] = f"Bearer {self.key}"
        address = f"{self.url.rstrip('/')}{BASE}{path}"
        request = urllib.request.Request(address, data, headers, method=method)  # noqa: S310 - http or https, see above
        # a proxy would look for the daemon on its own machine
        is_here = urlsplit(self.url).hostname in LOOPBACK
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({} if is_here else None))
        try:
            with opener.open(request, timeout=timeout_s) as answer:
                return bytes(answer.read())
        except urllib.error.HTTPError as err:
            with err:
                raise _refusal(err) from None
        except (OSError, HTTPException, ValueError) as err:
            raise self._silence(getattr(err, "reason", err)) from None

    def _silence(self, reason: object) -> DaemonError:
        return DaemonError(f"no answer from {self.url}: {reason}: is the daemon running there?")


def _refusal(error: urllib.error.HTTPError) -> DaemonError:
    try:
        problem = json.load(error)
        return DaemonError(f"refused: {problem['detail']}", str(problem.get("type", "")).rpartition(":")[2])
    except (ValueError, KeyError, TypeError, AttributeError):
        return DaemonError(f"refused: {error.code} {error.reason}")
