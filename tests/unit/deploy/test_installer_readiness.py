"""What the installer takes the answer of a daemon for, and of others that listen at its address."""

import json
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from threading import Thread

import pytest
from installer.service import Readiness, ask_readiness


@pytest.fixture
def serve() -> Iterator[Callable[[bytes], str]]:
    """Return a function that serves one answer, and returns at which URL."""
    with ExitStack() as stack:

        def listen(answer: bytes) -> str:
            listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))

            def reply() -> None:
                connection, _ = listener.accept()
                with connection:
                    connection.recv(65536)
                    connection.sendall(answer)

            thread = Thread(target=reply, daemon=True)
            thread.start()
            stack.callback(thread.join, 60)
            return f"http://127.0.0.1:{listener.getsockname()[1]}"

        yield listen


NOT_READY = {"type": "urn:stonefall:problem:not-ready"}


def http(status: str, body: object) -> bytes:
    return f"HTTP/1.1 {status}\r\nConnection: close\r\n\r\n{json.dumps(body)}".encode()


def test_the_daemon_says_whether_it_is_ready(serve: Callable[[bytes], str]) -> None:
    assert ask_readiness(serve(http("200 OK", {"ready": True}))) == Readiness(True, True, "ready")
    held = serve(http("503 Service Unavailable", NOT_READY | {"detail": "the gate is silent"}))
    assert ask_readiness(held) == Readiness(True, False, "the gate is silent")


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (http("502 Bad Gateway", ["a proxy"]), "status 502, not from stonefall"),
        (http("404 Not Found", {"error": "another program"}), "status 404, not from stonefall"),
        (http("503 Service Unavailable", {"detail": "another program"}), "status 503, not from stonefall"),
        (http("500 Internal Server Error", NOT_READY | {"detail": "?"}), "status 500, not from stonefall"),
        (http("200 OK", {"detail": "another program"}), "status 200, not from stonefall"),
        (b"SSH-2.0-OpenSSH\r\n", "SSH-2.0-OpenSSH"),
        (b"", "closed connection"),
    ],
)
def test_another_program_is_no_daemon_that_answers(
    serve: Callable[[bytes], str], answer: bytes, said: str
) -> None:
    found = ask_readiness(serve(answer))
    assert (found.answers, found.ready) == (False, False)
    assert said in found.detail
