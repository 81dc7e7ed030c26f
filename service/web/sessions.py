"""Sessions of browsers: a cookie that a key was exchanged for, valid as long as the key and for twelve hours unused.

The cookie has the name of its key, when the session began and was last renewed, and a MAC over that and over the key's
hash: nothing is stored but the secret of the MAC, and those that were ended before their time. A session outlives a
restart, dies with its key, and a new key of the same name does not wake it.
"""

import base64
import binascii
import hmac
import json
import logging
import os
import secrets
import stat
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from drivers.files.durable import replacing
from service.web.key_file import StoredKey
from service.web.settings import ApiKey

log = logging.getLogger(__name__)

FILE = "sessions.json"
SECRET_BYTES = 32
UNUSED_S = 12 * 3600
"""A session ends when it was not renewed for so long."""
LONGEST_S = 30 * 24 * 3600
"""And at the latest so long after its beginning: a stolen cookie does not renew itself for ever."""
AHEAD_S = 300
"""A session from later than this after now is of a clock that was wrong, and might last for years."""
MAX_COOKIE = 1024
MAX_ENDED = 10_000
"""Sessions that were ended and are remembered; beyond, the oldest are forgotten."""
MAX_BYTES = 1_000_000

Key = ApiKey | StoredKey


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionCookie:
    """Contents of the cookie; times are seconds since 1970."""

    key: str  # its name
    id: str
    begun_s: int
    renewed_s: int

    @property
    def expires_s(self) -> int:
        """When it ends, unless it is renewed or its key ends before."""
        return min(self.renewed_s + UNUSED_S, self.begun_s + LONGEST_S)

    def is_valid(self, now_s: float) -> bool:
        """True between its beginning and its end, by a clock that may have been set."""
        return self.renewed_s - AHEAD_S <= now_s < self.expires_s


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionsFile:
    """The content of the file."""

    secret: str  # hexadecimal
    format: Literal["stonefall-sessions/1"] = "stonefall-sessions/1"
    ended: dict[str, int] = field(
        default_factory=dict
    )  # id -> when it would have ended, in the order of ending


COOKIE = TypeAdapter(SessionCookie)
CONTENT = TypeAdapter(SessionsFile)


class Sessions:
    """Begins, finds, renews and ends sessions; the file is read when the first is asked for."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._content: SessionsFile | None = None
        self._writing = threading.Lock()

    def begin(self, key: Key, now_s: float) -> tuple[SessionCookie, str]:
        """Return a new session of a key, and its cookie; blocks at the first time of a store."""
        session = SessionCookie(
            key=key.name, id=secrets.token_hex(16), begun_s=int(now_s), renewed_s=int(now_s)
        )
        return session, self._cookie(session, key)

    def renew(self, session: SessionCookie, key: Key, now_s: float) -> tuple[SessionCookie, str]:
        """Return the session as it is used now, and its cookie."""
        session = replace(session, renewed_s=max(session.renewed_s, int(now_s)))
        return session, self._cookie(session, key)

    def find(
        self, cookie: str, keys_named: Callable[[str], Sequence[Key]], now_s: float
    ) -> tuple[SessionCookie, Key] | None:
        """Return the session of a cookie and its key, which may have been revoked; None if it is not ours or has ended.

        The MAC is compared in constant time, and looked at before what it protects is believed.
        """
        payload, _, mac = cookie.partition(".")
        if len(cookie) > MAX_COOKIE:
            return None
        try:
            session = COOKIE.validate_json(_decoded(payload), strict=True)
            given = _decoded(mac)
        except (ValueError, ValidationError):
            return None
        for key in keys_named(session.key):
            if hmac.compare_digest(given, self._mac(payload, key)):
                is_alive = session.is_valid(now_s) and session.id not in self._known().ended
                return (session, key) if is_alive else None
        return None

    def end(self, session: SessionCookie, now_s: float) -> None:
        """End a session before its time, durably; blocks."""
        with self._writing:
            known = self._known()
            latest_s = session.begun_s + LONGEST_S  # it may have been renewed meanwhile
            ended = {name: until_s for name, until_s in known.ended.items() if until_s > now_s}
            ended = dict([*ended.items(), (session.id, latest_s)][-MAX_ENDED:])
            self._content = replace(known, ended=ended)
            self._write(self._content)

    def _cookie(self, session: SessionCookie, key: Key) -> str:
        payload = _encoded(json.dumps(asdict(session), separators=(",", ":")).encode())
        return f"{payload}.{_encoded(self._mac(payload, key))}"

    def _mac(self, payload: str, key: Key) -> bytes:
        secret = bytes.fromhex(self._known().secret)
        return hmac.digest(secret, f"stonefall session\n{key.sha256}\n{payload}".encode(), "sha256")

    def _known(self) -> SessionsFile:
        """Return the content of the file, a new one if there is none, it is damaged, or others could read it."""
        if self._content is None:
            try:
                self._content = self._read()
            except (OSError, ValueError) as err:
                if not isinstance(err, FileNotFoundError):
                    log.error("all browsers must sign in again: %s: %s", self._folder / FILE, err)
                self._content = SessionsFile(secret=secrets.token_hex(SECRET_BYTES))
                self._write(self._content)
        return self._content

    def _read(self) -> SessionsFile:
        descriptor = os.open(self._folder / FILE, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        with os.fdopen(descriptor, "rb") as file:
            if stat.S_IMODE(os.fstat(descriptor).st_mode) & 0o077:
                raise ValueError("others could read it")
            text = file.read(MAX_BYTES + 1)
        content = CONTENT.validate_json(text)
        if len(bytes.fromhex(content.secret)) != SECRET_BYTES:
            raise ValueError(f"the secret has not {SECRET_BYTES} bytes")
        return content

    def _write(self, content: SessionsFile) -> None:
        """Write the file; while the disk refuses, what it says holds until the daemon ends."""
        try:
            with replacing(self._folder / FILE, 0o600) as temporary:
                temporary.write_text(json.dumps(asdict(content)), encoding="utf-8")
        except OSError as err:
            log.error("sessions are not kept: %s: %s", self._folder / FILE, err.strerror)


def _encoded(content: bytes) -> str:
    return base64.urlsafe_b64encode(content).decode().rstrip("=")


def _decoded(text: str) -> bytes:
    """Decode base64url; raise `ValueError` for a text that `_encoded` would write otherwise."""
    try:
        content = base64.b64decode(text + "=" * (-len(text) % 4), altchars=b"-_", validate=True)
    except (binascii.Error, UnicodeEncodeError) as err:
        raise ValueError(text) from err
    if _encoded(content) != text:
        raise ValueError(text)
    return content
