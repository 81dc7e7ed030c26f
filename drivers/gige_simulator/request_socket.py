"""The control socket of the simulated rig: a Unix socket that answers each JSON object, one a line, with another."""

import json
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from socketserver import StreamRequestHandler, ThreadingUnixStreamServer
from typing import Any

MAX_REQUEST_BYTES = 65_536
STOP_POLL_S = 0.05
"""How often the listening thread looks whether it is to end."""

Answer = Callable[[Mapping[str, Any]], Mapping[str, Any]]
"""Carries out a request and returns the fields of the reply; `ValueError` says why it cannot be carried out."""


@contextmanager
def request_socket(path: Path, answer: Answer) -> Iterator[None]:
    """Listen at `path` while the block runs, a thread a client; `answer` is called by one of them at a time.

    Raises
    ------
    OSError
        The path is taken, too long for a socket, or its folder cannot be written.
    """
    _remove_stale(path)
    try:
        server = _Server(str(path), answer)
    except OSError as err:
        raise OSError(err.errno, f"cannot listen: {err}", str(path)) from err
    listening = threading.Thread(target=server.serve_forever, args=(STOP_POLL_S,), name="simulator requests")
    listening.start()
    try:
        yield
    finally:
        server.shutdown()
        listening.join()
        server.server_close()
        path.unlink(missing_ok=True)


class _Client(StreamRequestHandler):
    server: "_Server"

    def handle(self) -> None:
        """Answer line by line, until the client goes or sends a line that is too long."""
        with suppress(OSError):
            while (line := self.rfile.readline(MAX_REQUEST_BYTES)).endswith(b"\n"):
                self.wfile.write(json.dumps(self.server.reply(line)).encode() + b"\n")


class _Server(ThreadingUnixStreamServer):
    def __init__(self, path: str, answer: Answer) -> None:
        self._answer = answer
        self._answering = threading.Lock()
        self._clients: set[Any] = set()
        super().__init__(path, _Client)  # last: it calls `server_close` when the path is taken

    def reply(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
            if not isinstance(request, dict):
                raise ValueError(f"a request is a JSON object, not {request!r}")
            with self._answering:
                return {"ok": True, **self._answer(request)}
        except ValueError as err:
            return {"ok": False, "problem": str(err)}

    def process_request(self, request: Any, client_address: Any) -> None:
        self._clients.add(request)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        self._clients.discard(request)
        super().shutdown_request(request)

    def server_close(self) -> None:
        """Hang up, then wait for the clients' threads; requests not yet answered stay so."""
        for client in tuple(self._clients):
            with suppress(OSError):  # gone meanwhile
                client.shutdown(socket.SHUT_RDWR)
        super().server_close()


def _remove_stale(path: Path) -> None:
    """Remove the socket that a killed simulator left behind."""
    if not path.is_socket():
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
