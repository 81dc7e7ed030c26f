"""`stonefall keys`: the file that the daemon reads, and what is printed."""

import json
import os
import stat
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from support.configurations import REPLAY
from typer.testing import CliRunner, Result

from drivers.files.durable import unfinished
from service.commands.cli import build_app
from service.web.key_file import KEYS, LOCK, PREFIX, KeyFileError, create_key, read_keys, sha256_of
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


def keys(folder: Path, *arguments: str) -> Result:
    config = str(folder.parent / "stonefall.toml")
    return CliRunner().invoke(build_app(["keys"]), ["keys", *arguments, "--config", config])


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
    (key,) = read_keys(folder / KEYS)
    assert (key.sha256, key.scopes, key.expires_at) == (sha256_of(token), (Scope.READ, Scope.OPERATE), None)
    assert token not in (folder / KEYS).read_text()
    for name in (KEYS, LOCK):
        assert stat.S_IMODE((folder / name).stat().st_mode) == 0o600
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
    before = (folder / KEYS).read_bytes()
    answer = keys(folder, *arguments)
    if complaint is None:
        assert answer.exit_code == 0
        return
    assert answer.exit_code == 1
    assert complaint in str(answer.exception)
    assert (folder / KEYS).read_bytes() == before


def test_a_scope_that_is_none_is_wrong_usage(folder: Path) -> None:
    assert keys(folder, "create", "mes", "--scope", "everything").exit_code == 2
    assert not (folder / KEYS).exists()


def test_commands_at_once_lose_no_key(folder: Path) -> None:
    with ThreadPoolExecutor(8) as threads:
        names = [f"key{number}" for number in range(24)]
        list(threads.map(lambda name: create_key(folder, name, (Scope.READ,), None, "root"), names))
    assert {key.name for key in read_keys(folder / KEYS)} == set(names)


def test_a_damaged_file_is_named_and_not_replaced(folder: Path) -> None:
    keys(folder, "create", "mes")
    (folder / KEYS).write_text('{"format": "stonefall-keys/1", "keys": [{"name": "mes", "sha256": "hush"}]}')
    for arguments in (("create", "other"), ("list",), ("revoke", "mes")):
        answer = keys(folder, *arguments)
        assert isinstance(answer.exception, KeyFileError)
        assert f"{folder / KEYS}: keys.0." in str(answer.exception)
        assert "hush" not in str(answer.exception)
    assert "hush" in (folder / KEYS).read_text()


def test_what_a_killed_command_left_is_no_hindrance_and_is_not_followed(folder: Path) -> None:
    folder.mkdir()
    elsewhere = folder.parent / "elsewhere"
    elsewhere.write_text("of somebody else")
    unfinished(folder / KEYS).symlink_to(elsewhere)
    assert keys(folder, "create", "mes").exit_code == 0
    assert elsewhere.read_text() == "of somebody else"
    assert [key.name for key in read_keys(folder / KEYS)] == ["mes"]


def test_what_root_writes_belongs_to_the_daemon(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder.mkdir()
    given: list[tuple[int, int]] = []
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(os, "fchown", lambda descriptor, uid, gid: given.append((uid, gid)))
    create_key(folder, "mes", (Scope.READ,), None, "root")
    owner = folder.stat()
    assert given == 2 * [(owner.st_uid, owner.st_gid)]  # the file and its lock
