"""The control socket serves several clients, and ends whatever they do."""

import json
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from support.eventually import PATIENCE_S

from drivers.gige_simulator.request_socket import MAX_REQUEST_BYTES, request_socket


def echo(request: Mapping[str, Any]) -> Mapping[str, Any]:
    return {"echo": dict(request)}


def connected(path: Path) -> socket.socket:
    client = socket.socket(socket.AF_UNIX)
    client.settimeout(PATIENCE_S)
    client.connect(str(path))
    return client


def ask(client: socket.socket, **fields: Any) -> dict[str, Any]:
    client.sendall(json.dumps(fields).encode() + b"\n")
    with client.makefile("rb") as lines:
        answer: dict[str, Any] = json.loads(lines.readline())
    return answer


def test_clients_that_say_nothing_hold_up_nobody(tmp_path: Path) -> None:
    path = tmp_path / "control"
    with request_socket(path, echo):
        idle, busy = connected(path), connected(path)
        assert ask(busy, n=1) == {"ok": True, "echo": {"n": 1}}
        assert ask(idle, n=2) == {"ok": True, "echo": {"n": 2}}
    with idle, busy:
        assert idle.recv(1) == busy.recv(1) == b""
    assert not path.exists()


def test_a_request_that_is_too_long_ends_the_conversation(tmp_path: Path) -> None:
    with request_socket(tmp_path / "control", echo), connected(tmp_path / "control") as client:
        client.sendall(b" " * MAX_REQUEST_BYTES)
        assert client.recv(1) == b""


def test_what_a_killed_simulator_left_is_replaced_and_a_living_one_is_not(tmp_path: Path) -> None:
    path = tmp_path / "control"
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(path))
    with request_socket(path, echo), connected(path) as client:
        with pytest.raises(OSError, match=r"cannot listen: .*control"), request_socket(path, echo):
            pass
        assert ask(client)["ok"]
