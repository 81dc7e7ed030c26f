"""`stonefall remeasure` asks a daemon for one stone after the other, and says what came of each."""

import json
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest
from support.daemon_process import DaemonProcess
from typer.testing import CliRunner, Result

from service.commands.cli import build_app
from service.commands.daemon_client import DaemonClient, DaemonError

FAILURES = {"b": "not-kept", "c": "calibration-gone", "d": "not-measured"}


class FakeDaemon:
    """Answers in the place of a daemon: stones `a` to `e` may have frames, `x` and `y` have none, `z` was lost."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, dict[str, list[str]]]] = []
        self.failures = dict(FAILURES)

    def ask(self, url: str, path: str, body: Any = None, **_: object) -> dict[str, Any]:
        where = urlsplit(path)
        query = parse_qs(where.query)
        self.asked.append((f"{url}{where.path}", query))
        if where.path == "/particles":
            return self.page("edcba" if query["has_frames"] == ["true"] else "zyx", query)
        name = where.path.split("/")[2]
        if (kind := self.failures.get(name)) is not None:
            raise DaemonError(f"refused: {name}", kind)
        return {"is_new": name == "a"}

    @staticmethod
    def page(names: str, query: dict[str, list[str]]) -> dict[str, Any]:
        """Return the stones in pages of two."""
        begin = int(query.get("cursor", ["0"])[0])
        items = [{"id": each, "outcome": "lost" if each == "z" else "measured"} for each in names]
        more = str(begin + 2) if begin + 2 < len(items) else None
        return {"items": items[begin : begin + 2], "next_cursor": more}


@pytest.fixture
def daemon(monkeypatch: pytest.MonkeyPatch) -> FakeDaemon:
    daemon = FakeDaemon()
    monkeypatch.setattr(
        DaemonClient, "ask", lambda asked, *given, **more: daemon.ask(asked.url, *given, **more)
    )
    return daemon


def run(folder: Path, *options: str) -> Result:
    config = DaemonProcess(folder, folder / "recording", port=8123).config_path
    return CliRunner().invoke(build_app(["remeasure"]), ["remeasure", "--config", str(config), *options])


def test_each_stone_is_asked_for_and_named(tmp_path: Path, daemon: FakeDaemon) -> None:
    done = run(tmp_path, "--json", "--lot", "L 1", "--since", "2026-01-01T00:00:00Z")
    assert done.exit_code == 1  # some could not be measured
    assert json.loads(done.stdout) == {
        "revised": ["a"],
        "unchanged": ["e"],
        "without_frames": ["y", "x", "b"],
        "failed": {"c": "refused: c", "d": "refused: d"},
    }
    lists = [query for address, query in daemon.asked if address == "http://127.0.0.1:8123/particles"]
    assert all((query["lot"], query["kind"]) == (["L 1"], ["particle"]) for query in lists)
    asked = [address[-11] for address, _ in daemon.asked if address.endswith("/revisions")]
    assert asked == list("abcde")  # the oldest first


def test_people_are_told_in_two_lines(tmp_path: Path, daemon: FakeDaemon) -> None:
    daemon.failures = {"b": "not-kept"}
    done = run(tmp_path)
    assert done.exit_code == 0
    assert done.stdout.splitlines() == [
        "1 stones measured again, 3 were of this algorithm",
        "3 have no frames any more: y, x, b",
    ]


@pytest.mark.parametrize("kind", [None, "no-background", "unauthorized"])
def test_what_is_about_no_stone_ends_it(tmp_path: Path, daemon: FakeDaemon, kind: str | None) -> None:
    daemon.failures = {"b": kind}  # type: ignore[dict-item]
    if kind is None:

        def silent(*_: object, **__: object) -> dict[str, Any]:
            raise DaemonError("no answer from there")

        daemon.page = silent  # type: ignore[method-assign]
    done = run(tmp_path)
    assert isinstance(done.exception, DaemonError)
    assert not any("/c/" in address for address, _ in daemon.asked)
