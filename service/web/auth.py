"""Authentication and authorisation: bearer tokens with scopes, or sessions of browsers that showed one.

While there is no key, only this machine may write, and other hosts may read if `[api] without_keys` says so.
"""

import time
from collections.abc import Awaitable, Callable, Collection
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from fastapi.security.utils import get_authorization_scheme_param

from drivers.files.times import utc_now
from service.base.addresses import host_of, is_loopback
from service.store.keys import AccessKey
from service.web.clients import host_of_client, pause_problem
from service.web.context import ApiContext, Context
from service.web.idempotency import begin_attempt
from service.web.problems import Problem
from service.web.sessions import BrowserSession, require_own_page, session_cookie
from service.web.settings import Scope

THIS_MACHINE, ANYBODY = "this machine", "anybody"
"""Who asks without a key: from this machine, and from elsewhere where that is allowed."""
NO_KEYS = "there is no key yet: only this machine may ask; `stonefall keys create` makes one"
INVALID_TOKEN = {"WWW-Authenticate": 'Bearer error="invalid_token"'}
FORWARDED = ("forwarded", "x-forwarded-for", "x-forwarded-host", "x-real-ip", "via")
"""Headers by which a proxy on this machine says that it passes on a client's request."""

bearer = HTTPBearer(
    auto_error=False,
    scheme_name="key",
    description="The token that `stonefall keys create` printed, or of a key in the configuration, as bearer token."
    " A browser exchanges it for a cookie: `POST /session`",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Asker:
    """Requester of a request, with its scopes."""

    who: str | None  # for the audit; None: unknown
    scopes: Collection[str]
    refusal: str | None = None  # why the request has no key; None while there is none at all
    key: AccessKey | None = None
    session: BrowserSession | None = None


def require(scope: Scope) -> Callable[[Request, Context], Awaitable[None]]:
    """Return the dependency that raises the problem 401 or 403 for a request without a key of this scope."""

    async def admit(
        request: Request,
        context: Context,
        _: Annotated[HTTPAuthorizationCredentials | None, Security(bearer, scopes=[scope])] = None,
    ) -> None:
        asker = asker_of(request, context)
        if scope not in asker.scopes:
            raise _refusal(asker, scope)
        if asker.session is not None:
            require_own_page(request, context.settings)
        request.state.who, request.state.scopes = asker.who or ANYBODY, asker.scopes
        await begin_attempt(request)

    return admit


READABLE, OPERABLE, CONFIGURABLE = ([Depends(require(scope))] for scope in Scope)
"""Dependencies of routes that need a key of these scopes."""


def asker_of(request: Request, context: Context, *, counts_guess: bool = True) -> Asker:
    """Authenticate a request: by bearer token, else by the cookie of a session, else by its source address.

    Raises the problem 401 for a token that is none, or none any more, and 429 after too many of these.
    """
    keys = context.keys
    keys.refresh()
    is_local = _is_from_this_machine(request)
    if keys.is_empty:
        may_read = {Scope.READ} if context.settings.may_read_without_keys else set()
        scopes = set(Scope) if is_local else may_read
        if scopes:
            context.keyless.note(request)
        return Asker(who=THIS_MACHINE if is_local else None, scopes=scopes)
    free = {Scope.READ} if is_local and context.settings.loopback_reads_without_key else set()
    scheme, token = get_authorization_scheme_param(request.headers.get("authorization"))
    refusal = "send the token of a key as bearer token, or sign in"
    key: AccessKey | None = None
    session: BrowserSession | None = None
    if scheme.lower() == "bearer" and token:
        key = checked_key(request, context, token, counts_guess=counts_guess)
    elif (cookie := session_cookie(request)) is not None:
        session = context.sessions.find(cookie, time.time())
        key = None if session is None else keys.of_sha256(session.key_sha256)
        ended = "this session has ended: sign in again" if key is None else key.refusal(utc_now())
        if ended is not None:
            refusal, key = ended, None
    if key is None:
        return Asker(who=THIS_MACHINE if free else None, scopes=free, refusal=refusal)
    return Asker(who=f"key {key.name}", scopes={*key.scopes, *free}, key=key, session=session)


def has_right_key(request: Request, context: ApiContext) -> bool:
    """Check for any scope by key, session or origin of a request, without counting or refusing it."""
    try:
        return bool(asker_of(request, context, counts_guess=False).scopes)
    except Problem:
        return False


def checked_key(request: Request, context: ApiContext, token: str, *, counts_guess: bool = True) -> AccessKey:
    """Authenticate a bearer token.

    Raises the problem 401 when there is none, or it was revoked or has expired; 429 when there is none, after too many
    others from there.
    """
    key = context.keys.find(token)
    if key is not None:
        if (refusal := key.refusal(utc_now())) is not None:  # whose token it is, that is no guess
            raise Problem(401, "unauthorized", refusal, headers=INVALID_TOKEN)
        return key
    host, now_s = host_of_client(request), time.monotonic()
    if (pause_s := context.guesses.pause_s(host, now_s)) > 0:
        raise pause_problem("wrong keys came", host, pause_s)
    if counts_guess:
        context.guesses.note(host, now_s)
    raise Problem(401, "unauthorized", "there is no such key", headers=INVALID_TOKEN)


async def who(request: Request) -> str:
    """Return the name of the requester, for the audit; on a route that requires a scope."""
    return str(request.state.who)


Who = Annotated[str, Depends(who)]


def _refusal(asker: Asker, scope: Scope) -> Problem:
    """Return the problem of a requester that lacks a scope: 403 with a key, and for writes while there is none."""
    if asker.key is not None:
        lacks = "is a display's, which may only read: sign in with another key"
        detail = (
            f"key {asker.key.name!r} {lacks if asker.key.is_display else f'lacks the scope {str(scope)!r}'}"
        )
        challenge = f'Bearer error="insufficient_scope", scope="{scope}"'
        return Problem(403, "forbidden", detail, headers={"WWW-Authenticate": challenge})
    if asker.refusal is None and scope is not Scope.READ:
        return Problem(403, "forbidden", "only this machine may do this while there is no key")
    detail = asker.refusal or NO_KEYS
    return Problem(401, "unauthorized", detail, headers={"WWW-Authenticate": "Bearer"})


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
