"""The control socket of the simulated rig: a Unix socket, one JSON object a line in, one a line out.

A request names what to `do`, and `of` whom: a camera's id, `"cameras"` (all) or `"gate"`. The answer has
`"ok": true` and what was asked for, or `"ok": false` and the `problem`.

Example, with `socat - UNIX-CONNECT:PATH`::

    {"do": "fault", "of": "c03", "set": {"packet_loss": 0.01}}
    {"ok": true, "faults": {"c03": {"packet_loss": 0.01, "duplicate": 0.0, ...}}}
    {"do": "fault", "of": "c05", "set": {"packet_los": 1}}
    {"ok": false, "problem": "no fault 'packet_los'; there are packet_loss, ..."}
"""

import json
import selectors
import socket
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

MAX_REQUEST_BYTES = 65_536

Answer = Callable[[Mapping[str, Any]], Mapping[str, Any]]
"""What is done with a request; `ValueError` says why it cannot be."""


class ControlSocket:
    """Serves any number of clients on one thread, from `open` to `close`."""

    def __init__(self, path: Path, answer: Answer) -> None:
        self.path = path
        self._answer = answer
        self._selector = selectors.DefaultSelector()
        self._rest: dict[socket.socket, bytes] = {}
        self._is_closing = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="simulator control", daemon=True)

    def open(self) -> None:
        """Listen; raises `OSError` naming the path when it cannot."""
