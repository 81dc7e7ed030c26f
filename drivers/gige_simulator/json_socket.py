"""A Unix socket that answers one JSON object a line with another; one thread serves all clients."""

import json
import os
import selectors
import socket
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

MAX_REQUEST_BYTES = 65_536

Answer = Callable[[Mapping[str, Any]], Mapping[str, Any]]
"""What is done with a request; `ValueError` says why it cannot be."""


class JsonSocket:
    """Listens at `path` from `open` to `close`; `answer` is called on its thread."""

    def __init__(self, path: Path, answer: Answer) -> None:
        self.path = path
        self._answer = answer
        self._half_lines: dict[socket.socket, bytes] = {}
        self._wake_fd = -1
        self._thread = threading.Thread(target=self._serve, name="simulator control", daemon=True)

    def open(self) -> None:
        """Listen.

        Raises
        ------
        OSError
            The path is taken, too long for a socket, or its folder cannot be written.
        """
        self._remove_stale()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._listener.bind(str(self.path))
            self._listener.listen()
        except OSError as err:
            self._listener.close()
            raise OSError(err.errno, f"cannot listen: {err}", str(self.path)) from err
        self._wake_fd = os.eventfd(0)
        self._thread.start()

    def close(self) -> None:
        """End; requests not yet answered stay so."""
        if self._wake_fd < 0:
            return
        os.eventfd_write(self._wake_fd, 1)
        self._thread.join()
        os.close(self._wake_fd)
        self._wake_fd = -1
        for client in self._half_lines:
            client.close()
        self._listener.close()
        self.path.unlink(missing_ok=True)

    def _remove_stale(self) -> None:
        """Remove what a killed simulator left behind."""
        if not self.path.is_socket():
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            try:
                probe.connect(str(self.path))
            except ConnectionRefusedError:
                self.path.unlink()

    def _serve(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._wake_fd, selectors.EVENT_READ)
            selector.register(self._listener, selectors.EVENT_READ)
            while True:
                for key, _ in selector.select():
                    if key.fd == self._wake_fd:
                        return
                    if key.fileobj is self._listener:
                        client, _ = self._listener.accept()
                        self._half_lines[client] = b""
                        selector.register(client, selectors.EVENT_READ)
                    elif isinstance(key.fileobj, socket.socket) and not self._is_served(key.fileobj):
                        selector.unregister(key.fileobj)
                        del self._half_lines[key.fileobj]
                        key.fileobj.close()

    def _is_served(self, client: socket.socket) -> bool:
        """Answer what is complete; whether the client stays."""
        try:
            data = client.recv(MAX_REQUEST_BYTES)
            *lines, rest = (self._half_lines[client] + data).split(b"\n")
            for line in lines:
                client.sendall(json.dumps(self._answer_to(line)).encode() + b"\n")
        except OSError:
            return False
        self._half_lines[client] = rest
        return bool(data) and len(rest) <= MAX_REQUEST_BYTES

    def _answer_to(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
            if not isinstance(request, dict):
                raise ValueError(f"a request is a JSON object, not {request!r}")
            return {"ok": True, **self._answer(request)}
        except ValueError as err:
            return {"ok": False, "problem": str(err)}
