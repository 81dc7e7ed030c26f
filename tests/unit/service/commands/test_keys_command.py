"""`stonefall keys`: what it changes in the store, and what is printed."""

import json
import os
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from support.configurations import REPLAY
from support.daemon_process import free_port
from typer.testing import CliRunner, Result

from service.base.errors import StoreError
from service.commands.cli import build_app
from service.store import open_store
from service.store.history import DATABASE
from service.store.keys import FILE, PREFIX, create_key, sha256_of, stored_keys
from service.store.pairings import Pairing, key_of, note_pairing
from service.store.schema import connect, connect_reader
from service.web.settings import Scope

CONFIG = f"""
{REPLAY}[[api.keys]]
name = "scada"
sha256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "stonefall.toml").write_text(CONFIG)
    return tmp_path / "state"


def keys(folder: Path, *arguments: str, input: str | None = None) -> Result:
    config = str(folder.parent / "stonefall.toml")
    return CliRunner().invoke(build_app(["keys"]), ["keys", *arguments, "--config", config], input=input)


def listed(folder: Path) -> dict[str, dict[str, Any]]:
    answer = keys(folder, "list", "--json")
    assert answer.exit_code == 0
    return {key["name"]: key for key in json.loads(answer.stdout)["items"]}


def test_a_token_is_printed_once_and_only_its_hash_is_kept(folder: Path) -> None:
    answer = keys(folder, "create", "mes", "--scope", "read", "--scope", "operate")
    token = answer.stdout.strip()
    assert token.startswith(PREFIX)
    assert len(token) >= len(PREFIX) + 43  # 256 bits
    assert "not shown again" in answer.stderr
    (key,) = stored_keys(folder)
    assert (key.sha256, key.scopes, key.expires_at) == (sha256_of(token), (Scope.READ, Scope.OPERATE), None)
    assert token.encode() not in (folder / DATABASE).read_bytes()
    table = keys(folder, "list").stdout
    assert token not in table
    assert key.sha256 not in table
    other = json.loads(keys(folder, "create", "other", "--json").stdout)
    assert (other["name"], other["scopes"]) == ("other", ["read"])
    assert other["token"] != token


def test_the_list_has_all_keys_and_their_states(folder: Path) -> None:
    create_key(folder, "old", (Scope.READ,), "2026-01-01T00:00:00.000Z", "root")
    for name in ("mes", "lab"):
        assert keys(folder, "create", name, "--expires", "90d").exit_code == 0
    assert keys(folder, "revoke", "mes").exit_code == 0
    found = listed(folder)
    states = {name: key["state"] for name, key in found.items()}
    assert states == {"scada": "valid", "old": "expired", "mes": "revoked", "lab": "valid"}
    ends = datetime.fromisoformat(found["lab"]["expires_at"])
    assert timedelta(days=89) < ends - datetime.now(UTC) <= timedelta(days=90)
    assert found["mes"]["revoked_by"] == found["mes"]["created_by"] != None  # noqa: E711
    assert all("sha256" not in key for key in found.values())


@pytest.mark.parametrize(
    ("text", "expires_at"),
    [
        ("2099-01-01", "2099-01-01T00:00:00.000Z"),
        ("2099-01-01T06:00:00+02:00", "2099-01-01T04:00:00.000Z"),
    ],
)
def test_a_key_can_end_at_a_date(folder: Path, text: str, expires_at: str) -> None:
    assert keys(folder, "create", "mes", "--expires", text).exit_code == 0
    assert listed(folder)["mes"]["expires_at"] == expires_at


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("create", "mes", "--expires", "2020-01-01"), "is over already"),
        (("create", "mes", "--expires", "0d"), "is over already"),
        (("create", "mes", "--expires", "soon"), "must be a date such as"),
        (("create", "mes", "--expires", "99999d"), None),
        (("create", "a b"), "a name has 1 to 64 letters"),
        (("create", "scada"), "is in the configuration"),
        (("revoke", "scada"), "is in the configuration"),
        (("revoke", "nobody"), "there is no key 'nobody' to revoke"),
        (("create", "first"), "there is a key 'first'"),
    ],
)
def test_wrong_requests_say_why_and_change_nothing(
    folder: Path, arguments: tuple[str, ...], complaint: str | None
) -> None:
    keys(folder, "create", "first")
    before = stored_keys(folder)
    answer = keys(folder, *arguments)
    if complaint is None:
        assert answer.exit_code == 0
        return
    assert answer.exit_code == 1
    assert complaint in str(answer.exception)
    assert stored_keys(folder) == before


def test_a_scope_that_is_none_is_wrong_usage(folder: Path) -> None:
    assert keys(folder, "create", "mes", "--scope", "everything").exit_code == 2
    assert not folder.exists()


def test_commands_at_once_lose_no_key(folder: Path) -> None:
    create_key(folder, "first", (Scope.READ,), None, "root")
    with ThreadPoolExecutor(8) as threads:
        names = [f"key{number}" for number in range(24)]
        list(threads.map(lambda name: create_key(folder, name, (Scope.READ,), None, "root"), names))
    assert {key.name for key in stored_keys(folder)} == {"first", *names}


def test_a_damaged_store_is_named_and_not_replaced(folder: Path) -> None:
    keys(folder, "create", "mes")
    (folder / DATABASE).write_bytes(4096 * b"hush")
    for arguments in (("create", "other"), ("list",), ("revoke", "mes")):
        answer = keys(folder, *arguments)
        assert isinstance(answer.exception, StoreError)
        assert str(answer.exception) == f"{folder / DATABASE}: file is not a database"
    assert (folder / DATABASE).read_bytes() == 4096 * b"hush"


def test_the_file_of_an_earlier_release_is_read_and_taken_over(folder: Path) -> None:
    folder.mkdir()
    key = {"name": "mes", "sha256": 64 * "0", "scopes": ["read"], "created_by": "ann"}
    text = json.dumps(
        {"format": "stonefall-keys/1", "keys": [{**key, "created_at": "2026-01-01T00:00:00.000Z"}]}
    )
    (folder / FILE).write_text(text)
    assert listed(folder).keys() == {"scada", "mes"}
    assert "there is a key 'mes'" in str(keys(folder, "create", "mes").exception)
    assert keys(folder, "revoke", "mes").exit_code == 0
    assert listed(folder)["mes"]["state"] == "revoked"
    assert not (folder / FILE).exists()
    assert (folder / f"{FILE}.taken-over").read_text() == text


def test_a_damaged_file_of_an_earlier_release_is_named_without_its_hashes(folder: Path) -> None:
    folder.mkdir()
    (folder / FILE).write_text('{"format": "stonefall-keys/1", "keys": [{"name": "mes", "sha256": "hush"}]}')
    answer = keys(folder, "list")
    assert f"{folder / FILE}: 0." in str(answer.exception)
    assert "hush" not in str(answer.exception)


def test_what_root_writes_belongs_to_the_daemon(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder.mkdir()
    became: list[int] = []
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(os, "setegid", became.append)
    monkeypatch.setattr(os, "seteuid", became.append)
    create_key(folder, "mes", (Scope.READ,), None, "root")
    owner = folder.stat()
    assert became == [owner.st_gid, owner.st_uid]


CODE = "123456"


def waiting(folder: Path, address: str = "192.0.2.9") -> None:
    """Have a screen wait, as the daemon notes it."""
    with open_store(folder), closing(connect(folder / DATABASE)) as connection:
        note_pairing(connection, Pairing(CODE, address, "Wall/1.0", int(time.time())), {CODE})


def test_a_screen_is_paired_after_a_look_at_it(folder: Path) -> None:
    keys(folder, "create", "boss")
    waiting(folder)
    refused = keys(folder, "pair", CODE, "--name", "silo-2", input="n\n")
    assert refused.exit_code != 0 and "shown at 192.0.2.9 by: Wall/1.0" in refused.stdout
    assert "silo-2" not in listed(folder)
    done = keys(folder, "pair", CODE, input="y\nsilo-2\n")
    assert done.exit_code == 0 and "keys revoke silo-2" in done.stdout
    assert (listed(folder)["silo-2"]["scopes"], listed(folder)["silo-2"]["is_display"]) == (["read"], True)
    assert "read, display" in keys(folder, "list").stdout
    again = keys(folder, "pair", CODE, "--name", "other", "--yes")
    assert again.exit_code != 0 and "no screen shows this code" in str(again.exception)
    with connect_reader(folder / DATABASE) as connection:
        assert key_of(connection, CODE) == next(
            key.sha256 for key in stored_keys(folder) if key.name == "silo-2"
        )


def test_a_role_gives_its_scopes_and_a_taken_name_none(folder: Path) -> None:
    waiting(folder)
    assert "no screen shows this code" in str(
        keys(folder, "pair", "000000", "--name", "a", "--yes").exception
    )
    taken = keys(folder, "pair", CODE, "--name", "scada", "--yes")
    assert "is in the configuration" in str(taken.exception)
    assert keys(folder, "pair", CODE, "--role", "operator", "--name", "desk", "--yes").exit_code == 0
    assert (listed(folder)["desk"]["scopes"], listed(folder)["desk"]["is_display"]) == (
        ["read", "operate"],
        False,
    )


def test_a_display_has_no_other_scope(folder: Path) -> None:
    assert keys(folder, "create", "wall", "--display", "--scope", "operate").exit_code != 0
    assert keys(folder, "create", "wall", "--display").exit_code == 0
    assert listed(folder)["wall"]["is_display"]


def test_the_first_key_says_so_and_the_next_does_not(folder: Path) -> None:
    config = folder.parent / "stonefall.toml"
    config.write_text(f"{REPLAY}[api]\nport = {free_port()}\n")
    said = "this is the first key: from now on every page and program needs one"
    assert said in keys(folder, "create", "a").stderr
    assert said not in keys(folder, "create", "b").stderr
