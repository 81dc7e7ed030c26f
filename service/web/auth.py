"""Authentication and authorisation: bearer tokens with scopes, or sessions of browsers that showed one.

While there is no key, only this machine may write, and other hosts may read if `[api] without_keys` says so.
"""

import logging
import math
import time
from collections.abc import Awaitable, Callable, Collection
from dataclasses import dataclass
from functools import partial
from typing import Annotated

from fastapi import Depends, Request, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from drivers.files.times import utc_now
from service.base.addresses import host_of, is_loopback
from service.base.errors import StoreError
from service.web.clients import host_of_client
from service.web.context import ApiContext, Context
from service.web.idempotency import begin_attempt
from service.web.key_file import StoredKey
from service.web.key_guesses import KeyGuesses
from service.web.key_ring import KeyRing, note_keys
from service.web.problems import Problem
from service.web.session_cookies import require_own_page, session_cookie
from service.web.sessions import Key, SessionCookie
from service.web.settings import Scope

log = logging.getLogger(__name__)

THIS_MACHINE, ANYBODY = "this machine", "anybody"
"""Who asks without a key: from this machine, and from elsewhere where that is allowed."""
INVALID_TOKEN = {"WWW-Authenticate": 'Bearer error="invalid_token"'}
FORWARDED = ("forwarded", "x-forwarded-for", "x-forwarded-host", "x-real-ip", "via")
"""Headers by which a proxy on this machine says that it passes on a client's request."""

bearer = HTTPBearer(
    auto_error=False,
    scheme_name="key",
    description="The token that `stonefall keys create` printed, or of a key in the configuration, as bearer token."
    " A browser exchanges it for a cookie: `POST /session`",
)
Credentials = Annotated[HTTPAuthorizationCredentials | None, Depends(bearer)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Asker:
    """Requester of a request, with its scopes."""

    who: str | None  # for the audit; None: unknown
    scopes: Collection[Scope]
    refusal: Callable[[Scope], Problem]  # of a scope that is lacking
    key: Key | None = None
    session: SessionCookie | None = None  # of a browser


def require(scope: Scope) -> Callable[[Request, Context, Credentials], Awaitable[None]]:
    """Return the dependency that raises the problem 401 or 403 for a request without a key of this scope."""

    async def admit(
        request: Request,
        context: Context,
        credentials: Annotated[HTTPAuthorizationCredentials | None, Security(bearer, scopes=[scope])],
    ) -> None:
        asker = await asker_of(request, context, credentials)
        if scope not in asker.scopes:
            raise asker.refusal(scope)
        if asker.session is not None:
            require_own_page(request, context.settings)
        request.state.who = asker.who or ANYBODY
        await begin_attempt(request)

    return admit


READABLE, OPERABLE, CONFIGURABLE = ([Depends(require(scope))] for scope in Scope)
"""Dependencies of routes that need a key of these scopes."""


async def asker_of(request: Request, context: Context, credentials: Credentials) -> Asker:
    """Authenticate a request: by bearer token, else by the cookie of a session, else by its source address.

    Raises
    ------
    Problem
        401 for a token that is none, or none any more, and 429 after too many of these.
    """
    keys = await keys_now(context)
    is_local = _is_from_this_machine(request)
    if keys.is_empty:
        return _asker_without_keys(context, is_local)
    free = {Scope.READ} if is_local and context.settings.loopback_reads_without_key else set()
    key: Key | None = None
    session: SessionCookie | None = None
    refusal = "send the token of a key as bearer token, or sign in"
    if credentials is not None:
        key = checked_key(request, context, credentials.credentials)
    elif (cookie := session_cookie(request)) is not None:
        found = context.sessions.find(cookie, keys.named, time.time())
        ended = "this session has ended: sign in again" if found is None else _refusal(found[1])
        if found is not None and ended is None:
            session, key = found
        refusal = ended or refusal
    if key is None:
        return Asker(
            who=THIS_MACHINE if free else None, scopes=free, refusal=lambda _: _unauthorized(refusal)
        )
    return Asker(
        who=f"key {key.name}",
        scopes={*key.scopes, *free},
        refusal=partial(_lacks, key),
        key=key,
        session=session,
    )


def has_right_key(request: Request, context: ApiContext) -> bool:
    """Check for any scope by key, session or origin of a request, without counting or refusing it."""
    keys = context.keys
    keys.refresh()
    is_local = _is_from_this_machine(request)
    if keys.is_empty:
        return bool(_asker_without_keys(context, is_local).scopes)
    scheme, _, token = request.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        key: Key | None = keys.find(token.strip())
    elif (cookie := session_cookie(request)) is not None:
        _, key = context.sessions.find(cookie, keys.named, time.time()) or (None, None)
    else:
        return is_local and context.settings.loopback_reads_without_key
    return key is not None and _refusal(key) is None


def checked_key(request: Request, context: ApiContext, token: str) -> Key:
    """Authenticate a bearer token.

    Raises
    ------
    Problem
        401: there is none, or it was revoked or has expired; 429: there is none, after too many others from there.
    """
    key = context.keys.find(token)
    if key is None:
        raise _wrong_key(context.guesses, host_of_client(request), time.monotonic())
    if (refusal := _refusal(key)) is not None:  # whose token it is, that is no guess
        raise Problem(401, "unauthorized", refusal, headers=INVALID_TOKEN)
    return key


def _wrong_key(guesses: KeyGuesses, host: str, now_s: float) -> Problem:
    if (pause_s := guesses.pause_s(host, now_s)) > 0:
        wait_s = math.ceil(pause_s)
        detail = f"too many wrong keys came from {host}, and this is another: try again in {wait_s} s"
        return Problem(429, "too-many-attempts", detail, retry_after_s=wait_s)
    guesses.note_wrong(host, now_s)
    return Problem(401, "unauthorized", "there is no such key", headers=INVALID_TOKEN)


def who(request: Request) -> str:
    """Return the name of the requester, for the audit; on a route that requires a scope."""
    return str(request.state.who)


Who = Annotated[str, Depends(who)]


def _refusal(key: Key) -> str | None:
    return key.refusal(utc_now()) if isinstance(key, StoredKey) else None


async def keys_now(context: ApiContext) -> KeyRing:
    """Return the keys as they are now, and note in the audit what `stonefall keys` has changed."""
    keys = context.keys
    keys.refresh()
    if not keys.is_noted:
        keys.is_noted = True
        try:
            await context.store.write_soon(note_keys, keys.stored)
        except StoreError as err:
            log.error("changes of keys are not in the audit: %s", err)
    return keys


def _asker_without_keys(context: ApiContext, is_local: bool) -> Asker:
    scopes = set(Scope) if is_local else {Scope.READ} if context.settings.may_read_without_keys else set()
    return Asker(who=THIS_MACHINE if is_local else None, scopes=scopes, refusal=_not_without_keys)


def _not_without_keys(scope: Scope) -> Problem:
    if scope is not Scope.READ:
        return Problem(403, "forbidden", "only this machine may do this while there is no key")
    return _unauthorized("there is no key yet: only this machine may ask; `stonefall keys create` makes one")


def _unauthorized(detail: str) -> Problem:
    return Problem(401, "unauthorized", detail, headers={"WWW-Authenticate": "Bearer"})


def _lacks(key: Key, scope: Scope) -> Problem:
    return Problem(
        403,
        "forbidden",
        f"key {key.name!r} lacks the scope {str(scope)!r}",
        headers={"WWW-Authenticate": f'Bearer error="insufficient_scope", scope="{scope}"'},
    )


def _is_from_this_machine(request: Request) -> bool:
    """True when both the peer and the host name it asked for are loopback, and the request came through no proxy.

    A proxy on this machine is a peer on loopback, too, but passes on the name that its clients asked for, or says for
    whom it asks.
    """
    is_forwarded = any(name in request.headers for name in FORWARDED)
    return (
        is_loopback(host_of_client(request))
        and is_loopback(host_of(request.headers.get("host", "")))
        and not is_forwarded
    )
