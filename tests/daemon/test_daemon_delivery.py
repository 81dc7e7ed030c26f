"""The real daemon tells an endpoint of lots and writes their files, over kills, at least once and in order."""

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from support.daemon_process import DaemonProcess
from support.eventually import PATIENCE_S, eventually
from support.small_recording import write_small_recording
from support.webhook_receiver import KEY, SECRET, Request, is_signed

N_STONES = 4
DELIVERY = """
[webhooks]
allowed_hosts = ["127.0.0.1"]
[[webhooks.endpoints]]
name = "mes"
url = "http://127.0.0.1:{port}/hook"
secrets = ["{secret}"]
events = ["lot.opened", "lot.assigned", "lot.closed"]
[file_drop]
dir = "drop"
formats = ["csv", "json"]
"""


class Mes:
    """An endpoint that takes everything, or, while `is_hanging`, answers nothing."""

    def __init__(self) -> None:
        self.requests: list[Request] = []
        self.is_hanging = threading.Event()
        self.is_over = threading.Event()
        mes = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                headers = {name.lower(): value for name, value in self.headers.items()}
                body = self.rfile.read(int(headers["content-length"]))
                mes.requests.append(Request(line=self.requestline, headers=headers, body=body))
                if mes.is_hanging.is_set():
                    mes.is_over.wait(PATIENCE_S)
                    return
                self.send_response(204)
                self.end_headers()

            def log_message(self, *_: Any) -> None: ...

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self.server.serve_forever, args=(0.05,), name="mes")
        self._thread.start()

    def close(self) -> None:
        self.is_over.set()
        self.server.shutdown()
        self.server.server_close()
        self._thread.join()

    def told(self) -> list[tuple[int, str]]:
        return [(each.event, each.document["type"]) for each in self.requests]


@pytest.fixture
def mes() -> Iterator[Mes]:
    mes = Mes()
    yield mes
    mes.close()


@pytest.mark.full
def test_lots_are_told_and_written_over_kills(tmp_path: Path, mes: Mes) -> None:
    write_small_recording(tmp_path / "recording", n_stones=N_STONES)
    drop = tmp_path / "drop"
    drop.mkdir()
    delivery = DELIVERY.format(port=mes.server.server_port, secret=SECRET)
    with DaemonProcess(tmp_path, tmp_path / "recording", segmentation=delivery) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda found: found["measured"] == N_STONES)
        daemon.put("/products/basalt", {"title": "8/16", "density_kg_m3": 2700})
        daemon.post("/lots", {"lot": "L1", "product": "basalt"})
        times = {"since": "2000-01-01T00:00:00Z", "until": "2100-01-01T00:00:00Z"}
        assert daemon.post("/lots/L1/assign", times)["n_assigned"] == N_STONES
        eventually(lambda: len(mes.requests) == 2)
        mes.is_hanging.set()
        drop.rename(tmp_path / "unmounted")
        daemon.post("/lots/L1/close", {})
        eventually(lambda: len(mes.requests) >= 3)  # it was sent and nothing is noted
        check = daemon.wait_for("/health", lambda found: found["checks"]["file_drop"]["status"] == "warn")
        assert "there is no such folder" in check["checks"]["file_drop"]["detail"]
        assert check["ne107"] != "failure"
        daemon.process.kill()
        daemon.process.wait()
    mes.is_hanging.clear()
    (tmp_path / "unmounted").rename(drop)
    with DaemonProcess(tmp_path, tmp_path / "recording", segmentation=delivery) as daemon:
        daemon.hear("READY=1")
        (endpoint,) = daemon.wait_for(
            "/webhooks", lambda found: found["items"][0]["last_taken_at"] and not found["items"][0]["waiting"]
        )["items"]
        assert (endpoint["last_problem"], SECRET in str(endpoint)) == (None, False)
        eventually(lambda: {path.name for path in drop.iterdir()} == {"L1-1.csv", "L1-1.json"})
        assert '"measured":4' in (drop / "L1-1.json").read_text()
        assert daemon.stop() == 0
    assert "Traceback" not in daemon.log
    kinds = [kind for _, kind in mes.told()]
    assert kinds[:2] == ["lot.opened", "lot.assigned"]
    assert kinds[2:] == ["lot.closed"] * max(
        2, len(kinds) - 2
    )  # a slow machine tries again before the kill, too
    assert len({(each.id, each.body) for each in mes.requests[2:]}) == 1
    assert all(is_signed(each.headers, each.body, KEY) for each in mes.requests)
    assert SECRET not in daemon.log
