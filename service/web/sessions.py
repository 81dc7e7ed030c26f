"""Sessions of browsers: a cookie that a key was exchanged for, valid as long as the key and for twelve hours unused.

Of the cookie only the hash is stored. A session outlives a restart, dies with its key, and a new key of the same name
does not wake it. Those of wall screens last as long as the key.

Browsers send cookies with whatever any page asks for, and keep them by the name of the host alone: other ports and, for
`SameSite`, other hosts of the domain count as ours. So what is written with a cookie must come from a page of our very
origin, and over TLS the cookie has a name (`__Host-`) that no other host of the domain can set.
"""

import logging
import secrets
import sqlite3
from dataclasses import astuple, dataclass, replace

from fastapi import Request, Response

from service.base.addresses import host_of, is_loopback
from service.store import Store
from service.store.keys import AccessKey, sha256_of
from service.web.problems import Problem
from service.web.settings import ApiSettings

log = logging.getLogger(__name__)

UNUSED_S = 12 * 3600
"""A session ends when it was not renewed for so long."""
LONGEST_S = 30 * 24 * 3600
"""And at the latest so long after its beginning: a stolen cookie does not renew itself for ever."""
AHEAD_S = 300
"""A session from later than this after now is of a clock that was wrong, and might last for years."""
RENEWED_S = 60
"""Least time between two renewals that are written."""
LASTING_S = 400 * 24 * 3600
"""Time after which a wall screen's session ends unless renewed: browsers keep no cookie longer."""
MAX_SESSIONS = 10_000
"""Beyond, those that were begun first end, of wall screens last."""
NAME, NAME_OVER_TLS = "stonefall-session", "__Host-stonefall-session"
PROXY = "a proxy in front of this service must pass on Host and X-Forwarded-Proto"
READING = frozenset({"GET", "HEAD"})


@dataclass(frozen=True, slots=True)
class BrowserSession:
    """A session, column by column; times are seconds since 1970."""

    cookie_sha256: str
    key_sha256: str
    begun_s: int
    renewed_s: int
    is_lasting: bool = False  # of a wall screen

    @property
    def expires_s(self) -> int:
        """When it ends, unless it is renewed or its key ends before."""
        if self.is_lasting:
            return self.renewed_s + LASTING_S
        return min(self.renewed_s + UNUSED_S, self.begun_s + LONGEST_S)


class Sessions:
    """Begins, finds, renews and ends sessions: in memory at once, then in the store."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._sessions = {each.cookie_sha256: each for each in store.read_here(_stored_sessions)}

    def begin(self, key: AccessKey, now_s: int) -> tuple[BrowserSession, str]:
        """Return a new session of a key, and its cookie."""
        self._sessions = {sha256: each for sha256, each in self._sessions.items() if now_s < each.expires_s}
        over = "DELETE FROM browser_sessions WHERE renewed_s <= ? OR NOT is_lasting AND"
        self._write(f"{over} renewed_s <= ?", now_s - LASTING_S, now_s - UNUSED_S)
        self._write(f"{over} begun_s <= ?", now_s - LASTING_S, now_s - LONGEST_S)
        if len(self._sessions) >= MAX_SESSIONS:
            self.end(min(self._sessions.values(), key=lambda each: each.is_lasting))
        cookie = secrets.token_urlsafe(32)
        return self._put(BrowserSession(sha256_of(cookie), key.sha256, now_s, now_s, key.is_display)), cookie

    def find(self, cookie: str, now_s: float) -> BrowserSession | None:
        """Return the session of a cookie; None if it is not ours or has ended, by a clock that may have been set."""
        session = self._sessions.get(sha256_of(cookie))
        if session is None or now_s >= session.expires_s:
            return None
        return session if session.is_lasting or session.renewed_s - AHEAD_S <= now_s else None

    def renew(self, session: BrowserSession, now_s: float) -> BrowserSession:
        """Return the session as it is used now."""
        if now_s < session.renewed_s + RENEWED_S:
            return session
        return self._put(replace(session, renewed_s=int(now_s)))

    def end(self, session: BrowserSession) -> None:
        """End a session before its time."""
        self._sessions.pop(session.cookie_sha256, None)
        self._write("DELETE FROM browser_sessions WHERE cookie_sha256 = ?", session.cookie_sha256)

    def _put(self, session: BrowserSession) -> BrowserSession:
        self._sessions[session.cookie_sha256] = session
        self._write("INSERT OR REPLACE INTO browser_sessions VALUES (?, ?, ?, ?, ?)", *astuple(session))
        return session

    def _write(self, statement: str, *values: str | int) -> None:
        """Write soon; while the disk refuses, what memory has holds until the daemon ends."""
        if (trouble := self._store.trouble) is None:
            self._store.write_later(_execute, statement, values)
        else:
            log.error("sessions are not kept: %s", trouble)


def _stored_sessions(connection: sqlite3.Connection) -> list[BrowserSession]:
    rows = connection.execute("SELECT * FROM browser_sessions ORDER BY begun_s")
    return [BrowserSession(*row) for row in rows]


def _execute(connection: sqlite3.Connection, statement: str, values: tuple[str | int, ...]) -> None:
    connection.execute(statement, values)


def session_cookie(request: Request) -> str | None:
    """Return the cookie of a session; None without one, and if there are several, of which one is not from us."""
    name = _name(request)
    found = set()
    for pair in ";".join(request.headers.getlist("cookie")).split(";"):
        key, _, value = pair.partition("=")
        if key.strip() == name:
            found.add(value.strip())
    return found.pop() if len(found) == 1 else None


def set_session_cookie(request: Request, response: Response, cookie: str, lasts_s: float) -> None:
    """Set the cookie of a session, for this host alone and hidden from scripts; one that lasts no time is cleared."""
    response.set_cookie(
        _name(request),
        cookie,
        max_age=max(0, int(lasts_s)),
        path="/",
        secure=_is_over_tls(request),
        httponly=True,
        samesite="strict",
    )
    response.headers["Cache-Control"] = "no-store"


def require_own_page(request: Request, settings: ApiSettings) -> None:
    """Reject cross-origin writes that carry the session cookie (CSRF) with the problem 403.

    Reads do no harm: no other origin is allowed to see an answer, and a browser may follow a link. A write needs the
    `Origin` that browsers send with each: programs use no cookie.
    """
    origin = request.headers.get("origin")
    if request.method not in READING and not (origin and is_own_origin(request, origin, settings)):
        detail = (
            f"with a session only our own pages may write, not {origin!r} ({PROXY}); programs send their key"
        )
        raise Problem(403, "foreign-origin", detail)


def require_own_sign_in(request: Request, settings: ApiSettings) -> None:
    """Reject a sign-in that a page of another origin asks for, with the problem 403."""
    origin = request.headers.get("origin")
    if origin is not None and not is_own_origin(request, origin, settings):
        raise Problem(403, "foreign-origin", f"a page of {origin!r} must not sign in here; {PROXY}")


def own_address(request: Request, settings: ApiSettings) -> str | None:
    """Return where the asking browser has our pages; None if only this machine finds them there."""
    netloc = request.headers.get("host", "")
    if netloc == "" or is_loopback(host_of(netloc)):
        return None
    return f"{'https' if _is_over_tls(request) else 'http'}://{netloc}{settings.path_prefix}"


def is_own_origin(request: Request, origin: str, settings: ApiSettings) -> bool:
    """True for an origin with the very scheme, host and port of the request, or with a proxy's name for us.

    A proxy that does not pass on the `Host` must have its name in `allowed_hosts`, and the port of its scheme.
    """
    scheme, _, netloc = origin.lower().partition("://")
    if scheme != ("https" if _is_over_tls(request) else "http"):
        return False
    names = {request.headers.get("host", "").lower(), *(name.lower() for name in settings.allowed_hosts)}
    return netloc != "" and netloc in names


def _name(request: Request) -> str:
    """Return the name of the cookie: of several instruments below one host each has its own.

    Its `Path` cannot tell them apart, because `__Host-` demands `/`.
    """
    prefix: str = request.app.state.context.settings.path_prefix
    return (NAME_OVER_TLS if _is_over_tls(request) else NAME) + prefix.replace("/", "-")


def _is_over_tls(request: Request) -> bool:
    """True when the browser speaks TLS, with the proxy in front of us; a lie harms its teller alone."""
    return request.headers.get("x-forwarded-proto", request.url.scheme).partition(",")[0].strip() == "https"
