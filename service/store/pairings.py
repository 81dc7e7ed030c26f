"""Screens that are to be signed in: each shows a code, which a person confirms (RFC 8628, device authorization grant).

The code opens nothing: who confirms it must be allowed to make keys, and the screen has a secret of its own (see
`service/web/pairings.py`). A code holds for minutes and for one screen.
"""

import secrets
import sqlite3
import time
from collections.abc import Collection
from dataclasses import astuple, dataclass
from http import HTTPStatus
from pathlib import Path

from drivers.files.times import utc_now
from service.base.errors import ProblemError, ProblemKind
from service.store import audit
from service.store.history import DATABASE
from service.store.keys import AccessKey, insert_key, new_token, sha256_of, writing
from service.store.schema import read

LASTS_S = 300
"""A code can be confirmed for so long, and the screen be signed in."""


class UnknownPairingError(ProblemError):
    """No screen shows this code now: it has run out, or was confirmed."""

    kinds = (ProblemKind("unknown-pairing", HTTPStatus.NOT_FOUND, "No screen shows this code"),)

    def __init__(self) -> None:
        super().__init__(f"no screen shows this code: each holds for {LASTS_S // 60} minutes, and once")


@dataclass(frozen=True, slots=True)
class Pairing:
    """A screen that waits, column by column; times are seconds since 1970."""

    code: str
    address: str
    user_agent: str
    opened_s: int
    key_sha256: str | None = None  # of the key that it was given

    def is_open(self, now_s: float) -> bool:
        """True until it has run out, by a clock that may have been set."""
        return self.opened_s <= now_s < self.opened_s + LASTS_S


def new_code(taken: Collection[str]) -> str:
    """Return six digits at random that no other screen shows."""
    while (code := f"{secrets.randbelow(10**6):06d}") in taken:
        pass
    return code


def note_pairing(connection: sqlite3.Connection, pairing: Pairing, known: Collection[str]) -> None:
    """Note a screen that waits; all but those with `known` codes are forgotten."""
    rows = connection.execute("SELECT code FROM pairings").fetchall()
    connection.executemany(
        "DELETE FROM pairings WHERE code = ?", [row for row in rows if row[0] not in known]
    )
    connection.execute("INSERT OR REPLACE INTO pairings VALUES (?, ?, ?, ?, ?)", astuple(pairing))


def key_of(connection: sqlite3.Connection, code: str) -> str | None:
    """Return the SHA-256 of the key that a screen was given, None until then."""
    row = connection.execute("SELECT key_sha256 FROM pairings WHERE code = ?", (code,)).fetchone()
    return None if row is None else row[0]


def open_pairing(connection: sqlite3.Connection, code: str) -> Pairing:
    """Return the screen that shows a code; raise `UnknownPairingError` if none waits with it."""
    row = connection.execute(
        "SELECT * FROM pairings WHERE code = ? AND key_sha256 IS NULL", (code,)
    ).fetchone()
    if row is None or not (pairing := Pairing(*row)).is_open(time.time()):
        raise UnknownPairingError
    return pairing


def confirm_pairing(
    connection: sqlite3.Connection, state_dir: Path, code: str, key: AccessKey, who: str
) -> Pairing:
    """Give the screen that shows a code a key of its own, within a transaction; its token is nowhere.

    Raises `UnknownPairingError`, or `KeyConflictError` for the key.
    """
    pairing = open_pairing(connection, code)
    insert_key(connection, state_dir, key)
    connection.execute("UPDATE pairings SET key_sha256 = ? WHERE code = ?", (key.sha256, code))
    screen = {"address": pairing.address, "user_agent": pairing.user_agent}
    audit.note(connection, who, "screen paired", key.name, after={**key.facts, **screen})
    return pairing


def key_without_token(name: str, scopes: tuple[str, ...], by: str, *, is_display: bool) -> AccessKey:
    """Return a new key for a screen, which needs no token."""
    return AccessKey(sha256_of(new_token()), name, scopes, utc_now(), by, is_display=is_display)


def waiting_screen(state_dir: Path, code: str) -> Pairing:
    """Return the screen that shows a code, for a command beside the daemon; raises as `open_pairing`."""
    return read(state_dir / DATABASE, open_pairing, code)


def pair_screen(state_dir: Path, code: str, key: AccessKey) -> None:
    """Confirm a code by a command beside the daemon; raises as `confirm_pairing`."""
    with writing(state_dir) as connection:
        confirm_pairing(connection, state_dir, code, key, f"stonefall keys of {key.created_by}")
