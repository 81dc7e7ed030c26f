"""Strangers at the door of a daemon that measures: raw requests, floods, hostile bodies, pages that are reloaded.

    python -m soak.attack [--times 10]      (PYTHONPATH=tests)

All of it goes to a daemon of its own on loopback. After each kind it must answer, and at the end every stone must be
accounted for; daemons of tests also fail when a callback holds their event loop.
"""

import argparse
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from urllib.parse import urlsplit

from support.daemon_process import DaemonProcess
from support.hostile_bodies import hostile_requests
from support.small_recording import write_small_recording

N_STONES = 8
N_FLOOD = 400
"""Connections of a flood that ask and are gone."""
N_PAGES = 20
"""Clients that reload the operator's page, and how often each does."""
PATIENCE_S = 300.0
HEAD = b"GET /api/v1/health/live HTTP/1.1\r\nHost: localhost\r\n"
RAW = (
    b"",
    b"\r\n\r\n",
    b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",  # a client that expects TLS
    b"GET\r\n\r\n",
    b"GET / HTTP/9.9\r\n\r\n",
    b"GET " + b"/" * 60_000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n",
    b"GET /%00%ff%c0%ae/../../etc/passwd HTTP/1.1\r\nHost: localhost\r\n\r\n",
    b"GET /api/v1/lots/%2e%2e/report HTTP/1.1\r\nHost: localhost\r\n\r\n",
    HEAD + b"X: " + b"x" * 70_000 + b"\r\n\r\n",
    HEAD + b"X: 1\r\n" * 20_000 + b"\r\n",
    HEAD + b"X: 1\r\n folded\r\n\r\n",
    HEAD + b"Content-Length: 1\r\nContent-Length: 2\r\n\r\nab",
    HEAD + b"Content-Length: -1\r\n\r\n",
    HEAD + b"Content-Length: 99999999999999999999\r\n\r\n",
    HEAD + b"Transfer-Encoding: chunked\r\nContent-Length: 5\r\n\r\n0\r\n\r\n",
    HEAD + b"Transfer-Encoding: chunked\r\n\r\nffffffffffffffff\r\n",
    HEAD + b"Transfer-Encoding: chunked\r\n\r\n-1\r\n\r\n",
    HEAD + b"Authorization: Bearer " + b"\xff" * 500 + b"\r\n\r\n",
    HEAD + b"Cookie: " + b"a=b;" * 10_000 + b"\r\n\r\n",
    HEAD + b"Range: bytes=0-,0-,0-\r\nIf-None-Match: " + b'"x",' * 5000 + b"\r\n\r\n",
    HEAD + b"Upgrade: websocket\r\nConnection: Upgrade\r\n\r\n",
    HEAD + b"Expect: 100-continue\r\nContent-Length: 10\r\n\r\n",
    HEAD * 200 + b"\r\n",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Attacked:
    """What one kind of attack came to."""

    kind: str
    n_requests: int
    longest_s: float  # until the daemon answered somebody else, asked all the while


def attack(folder: Path, times: int) -> Iterator[Attacked]:
    """Yield what each kind of attack came to; raise `AssertionError` if the daemon is not well afterwards."""
    recording = folder / "recording"
    write_small_recording(recording, n_stones=N_STONES)
    with DaemonProcess(folder, recording, rig="loop = true\nspeed = 0.5") as daemon:
        daemon.hear("READY=1")
        for kind in (raw_requests, gone_clients, hostile_bodies, reloaded_pages):
            yield _attacked(daemon, kind, times)
        before = daemon.get("/accounting")["measured"]
        daemon.wait_for("/accounting", lambda now: now["measured"] > before)  # it goes on measuring
        balance = daemon.get("/accounting")
        assert balance["is_balanced"], balance
        assert daemon.stop() == 0
        assert "Traceback" not in daemon.log, daemon.log


def raw_requests(daemon: DaemonProcess, times: int) -> int:
    """Send what is no request, or hardly one, and hear what comes; return how many were sent."""
    for _ in range(times):
        for data in RAW:
            with _connected(daemon) as connection, suppress(OSError):
                connection.sendall(data)
                connection.shutdown(socket.SHUT_WR)
                while connection.recv(65536):
                    pass
    return times * len(RAW)


def gone_clients(daemon: DaemonProcess, times: int) -> int:
    """Ask and close before the answer."""
    for _ in range(times * N_FLOOD):
        with suppress(OSError), _connected(daemon) as connection:
            connection.sendall(b"GET /api/v1/results?limit=1000 HTTP/1.1\r\nHost: localhost\r\n\r\n")
    return times * N_FLOOD


def hostile_bodies(daemon: DaemonProcess, times: int) -> int:
    """Send each tenth, or all, of the bodies that mean nothing; none may be answered by 500."""
    n_sent = 0
    for method, path, what, body in list(hostile_requests())[:: max(1, 10 // times)]:
        connection = HTTPConnection(urlsplit(daemon.url("")).netloc, timeout=PATIENCE_S)
        with suppress(ConnectionError, HTTPException):  # refused before it was sent
            connection.request(method.upper(), f"/api/v1{path}", body, {"Content-Type": "application/json"})
            answer = connection.getresponse()
            assert answer.status != 500, (method, path, what, answer.read())
        connection.close()
        n_sent += 1
    return n_sent


def reloaded_pages(daemon: DaemonProcess, times: int) -> int:
    """Open the stream of the operator's page and leave it, again and again, from several clients at once."""

    def reload() -> None:
        for _ in range(times * N_PAGES):
            with suppress(OSError), _connected(daemon) as connection:
                connection.sendall(b"GET /api/v1/overview/stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
                connection.recv(4096)

    clients = [threading.Thread(target=reload) for _ in range(N_PAGES)]
    for client in clients:
        client.start()
    for client in clients:
        client.join()
    return times * N_PAGES * N_PAGES


def _attacked(daemon: DaemonProcess, kind: Callable[[DaemonProcess, int], int], times: int) -> Attacked:
    """Attack while somebody else asks the daemon whether it lives."""
    is_over = threading.Event()
    waits_s = [0.0]

    def ask() -> None:
        while not is_over.wait(0.1):
            start_s, is_answered = time.monotonic(), False
            while not (is_answered or is_over.is_set()):
                with suppress(ConnectionError):  # pushed out by the flood: to ask again is a part of the wait
                    is_answered = daemon.get("/health/live")["status"] == "pass"
            waits_s.append(time.monotonic() - start_s)

    asking = threading.Thread(target=ask)
    asking.start()
    try:
        n_requests = kind(daemon, times)
    finally:
        is_over.set()
        asking.join()
    assert daemon.get("/health/live")["status"] == "pass"
    return Attacked(kind=kind.__name__.replace("_", " "), n_requests=n_requests, longest_s=max(waits_s))


def _connected(daemon: DaemonProcess) -> socket.socket:
    url = urlsplit(daemon.url(""))
    return socket.create_connection((url.hostname or "", url.port or 0), timeout=PATIENCE_S)


def main() -> None:
    """Attack a daemon and print what came of it."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--times", type=int, default=10, help="how often each kind is repeated")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(f"{'attack':<16} {'requests':>9} {'longest wait of another client, s':>34}")  # noqa: T201 - its result
        for each in attack(Path(folder), arguments.times):
            print(f"{each.kind:<16} {each.n_requests:9} {each.longest_s:34.2f}", flush=True)  # noqa: T201 - as above


if __name__ == "__main__":
    main()
