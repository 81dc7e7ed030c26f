"""A feed of results that misbehaves as it is told: a small HTTP server in the place of a daemon."""

import json
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

BASE = "/api/v1"
PROBLEM = "urn:stonefall:problem:"


@dataclass(frozen=True)
class Refusal:
    """A problem as the answer."""

    status: int
    kind: str
    headers: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Torn:
    """An answer whose connection is closed after this share of its content."""

    share: float


@dataclass(frozen=True)
class Other:
    """An answer with this content in the place of the right one."""

    content: bytes


Answer = Refusal | Torn | Other


@dataclass
class FakeFeed:
    """The state of a store, the answers that come next in the place of the right ones, and what was asked for."""

    instance_id: str = "aaaaaaaa"
    first_seq: int = 1
    last_seq: int = 0
    key: str | None = None  # without it: 401
    next_answers: deque[Answer] = field(default_factory=deque)
    asked: list[tuple[str, str, Mapping[str, str]]] = field(default_factory=list)  # method, path, headers
    bodies: list[Any] = field(default_factory=list)
    parked: dict[str, int] = field(default_factory=dict)
    balls: set[int] = field(default_factory=set)  # of the items
    documents: dict[str, dict[str, Any]] = field(default_factory=dict)  # by path, beside the feed
    url: str = ""

    def item(self, seq: int) -> dict[str, Any]:
        return {
            "seq": seq,
            "id": f"{self.instance_id}-{seq:08d}",
            "kind": "ball" if seq in self.balls else "particle",
            "bundle": f"{seq:06d}",
            "outcome": "measured",
            "quality": "good",
            "quality_causes": [],
            "zingg_class": "equant",
            "volume_mm3": 7.0 * seq,
            "sieve_size_mm": seq / 7,
            "timings_ms": {},
            "dropped_views": {},
            "detail": None,
        }

    def items(self, after: int, limit: int = 10**9) -> list[dict[str, Any]]:
        return [self.item(seq) for seq in range(after + 1, min(self.last_seq, after + limit) + 1)]

    def answer(self, path: str, query: Mapping[str, list[str]]) -> tuple[int, dict[str, Any]]:
        if path in self.documents or path != "/results":
            return 200, self.documents.get(path, {})
        after = int(query["after"][0])
        ends = {"first_seq": self.first_seq, "last_seq": self.last_seq}
        if after > self.last_seq:
            return 409, {"type": f"{PROBLEM}cursor-ahead", **ends}
        if after < self.first_seq - 1:
            return 410, {"type": f"{PROBLEM}cursor-expired", **ends}
        items = self.items(after, int(query["limit"][0]))
        next_after = items[-1]["seq"] if items else after
        return 200, {"instance_id": self.instance_id, **ends, "next_after": next_after, "items": items}


@contextmanager
def serving(feed: FakeFeed) -> Iterator[FakeFeed]:
    """Serve the feed at `feed.url`, on a port that the kernel chooses."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            url = urlsplit(self.path)
            feed.asked.append((self.command, self.path.removeprefix(BASE), dict(self.headers)))
            body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            if self.command != "GET":
                feed.bodies.append(json.loads(body))
            self.respond(feed.next_answers.popleft() if feed.next_answers else None, url.path, url.query)

        do_PUT = do_POST = do_GET  # noqa: N815 - the names that the library looks for

        def respond(self, instead: Answer | None, path: str, query: str) -> None:
            headers: Mapping[str, str] = {}
            share = 1.0
            if isinstance(instead, Refusal):
                status, headers = instead.status, instead.headers
                content = json.dumps({"type": PROBLEM + instead.kind, "detail": "told so"}).encode()
            elif isinstance(instead, Other):
                status, content = 200, instead.content
            elif (
                path != f"{BASE}/health/live"
                and feed.key is not None
                and (self.headers.get("Authorization") != f"Bearer {feed.key}")
            ):
                status, content = (
                    401,
                    json.dumps({"type": f"{PROBLEM}unauthorized", "detail": "no key"}).encode(),
                )
            else:
                if self.command == "PUT":
                    feed.parked[path.split("/")[-2]] = feed.bodies[-1]["after"]
                status, document = feed.answer(path.removeprefix(BASE), parse_qs(query))
                content = json.dumps(document).encode()
                share = instead.share if isinstance(instead, Torn) else 1.0
            if share > 0:
                self.send_response(status)
                self.send_header("Content-Length", str(len(content)))
                for name, value in headers.items():
                    self.send_header(name, value)
                self.end_headers()
            self.wfile.write(content[: int(share * len(content))])
            self.close_connection = share < 1

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = False  # they end with the connections of the clients
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    feed.url = f"http://127.0.0.1:{server.server_port}"
    try:
        yield feed
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
