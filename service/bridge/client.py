"""The reference client as the bridge uses it: with a user's token, and ended from another thread."""

import socket
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from service.bridge.reference_client import ANSWER_S, Client, NoAnswerError

PAUSE_S = 0.2
"""Time between two looks, in a pause, at whether it is over."""


class BridgeClient(Client):
    """A client that another thread can abandon; `token` stands for a key file."""

    def __init__(self, url: str, key_file: Path | None = None, token: str | None = None) -> None:
        super().__init__(url, key_file)
        self._token = token
        self._is_abandoned = self._is_asking = False

    def key(self) -> str:
        """Return the token, or that of the key file as it is now."""
        return super().key() if self._token is None else self._token

    def abandon(self) -> None:
        """End the request and the pause under way, if any, and fail all others. Thread-safe."""
        self._is_abandoned = True
        if not self._is_asking:
            self.close()
        elif (sock := self._connection.sock) is not None:
            with suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)  # not close, on which the other thread would wait on

    def pause(self, seconds: float) -> None:
        """Wait, but not for longer than the key stays the one that was sent last."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s and self.key() == self._key_sent and not self._is_abandoned:
            time.sleep(PAUSE_S)

    def ask(
        self,
        method: str,
        path: str,
        body: Mapping[str, Any] | None = None,
        headers: Mapping[str, str] | None = None,
        timeout_s: float = ANSWER_S,
    ) -> dict[str, Any]:
        """Return the answer; raise `NoAnswerError` once it is abandoned."""
        self._is_asking = True
        try:
            if self._is_abandoned:
                raise NoAnswerError("it is not waited for any more")
            return super().ask(method, path, body, headers, timeout_s)
        finally:
            self._is_asking = False
            if self._is_abandoned:
                self.close()
