"""Sign in with a browser: the token of a key is exchanged for the cookie of a session."""

import time
from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from pydantic import Field

from pipeline.frames import rfc3339
from service.base.schema import OptionalTime, request_body, served
from service.store.keys import AccessKey
from service.web.auth import Asker, asker_of, checked_key
from service.web.clients import Client
from service.web.context import ApiContext, Context
from service.web.problems import problem_responses
from service.web.sessions import (
    BrowserSession,
    require_own_page,
    require_own_sign_in,
    session_cookie,
    set_session_cookie,
)
from service.web.settings import Scope

router = APIRouter(prefix="/session", tags=["session"])


async def asker(request: Request, context: Context) -> Asker:
    """Identify the requester, known or not: these resources are open, and `openapi.json` names no key for them."""
    return asker_of(request, context)


Asking = Annotated[Asker, Depends(asker)]


@request_body
class SignIn:
    """The key to sign in with."""

    token: Annotated[str, Field(min_length=1, max_length=512, repr=False)]
    """What `stonefall keys create` printed"""


@served
class SessionDocument:
    """Who asks, and what that allows."""

    who: str | None
    """As in the audit: `key NAME`, or `this machine` where no key is needed; null: unknown"""
    scopes: list[Scope]
    """What may be asked for: `read`, `operate`, `configure`"""
    expires_at: OptionalTime
    """When the session ends unless it is renewed, RFC 3339 UTC; null without one"""
    has_keys: bool
    """Whether there are keys to sign in with; while there is none, only this machine may write"""
    is_display: bool
    """Whether it is a wall screen's, which only reads and stays signed in until its key is revoked"""
    keyless: list[Client]
    """While there is no key, for whom may make one: clients that asked without, the newest first. They will need one"""


@router.post("", response_model=SessionDocument, responses=problem_responses(401, 403, 429))
async def sign_in(request: Request, response: Response, context: Context, wanted: SignIn) -> SessionDocument:
    """Sign in: exchange the token of a key for a cookie that browsers send, and no script sees.

    It ends when it was not renewed for 12 h, after 30 days, with its key, and by `DELETE`; a restart it outlives. That
    of a wall screen (`is_display`) ends with its key alone, or when its browser did not ask for 400 days. What
    is written with it needs the `Origin` of our own pages. Programs need no session: they send their key. Wrong tokens
    count as everywhere. An `Idempotency-Key` has no effect: a session is never given twice.
    """
    require_own_sign_in(request, context.settings)
    context.keys.refresh()
    return await begin_session(request, response, context, checked_key(request, context, wanted.token))


async def begin_session(
    request: Request, response: Response, context: ApiContext, key: AccessKey
) -> SessionDocument:
    """Begin a session of a key, put its cookie into the answer, and note it in the audit."""
    now_s = int(time.time())
    session, cookie = context.sessions.begin(key, now_s)
    set_session_cookie(request, response, cookie, session.expires_s - now_s)
    document = _document(key, session)
    await context.store.note_change(
        f"key {key.name}", "session begun", key.name, after={"expires_at": document.expires_at}
    )
    return document


@router.get("", response_model=SessionDocument, responses=problem_responses(401, 429))
async def session(request: Request, response: Response, context: Context, asking: Asking) -> SessionDocument:
    """Get the session: who asks and what that allows; renews that of a browser. Needs no key.

    A page asks once in an hour. 401 only for an invalid bearer token.
    """
    response.headers["Cache-Control"] = "no-store"
    cookie = session_cookie(request)
    if asking.key is not None and asking.session is not None and cookie is not None:
        renewed = context.sessions.renew(asking.session, now_s := int(time.time()))
        set_session_cookie(request, response, cookie, renewed.expires_s - now_s)
        return _document(asking.key, renewed)
    if cookie is not None and asking.key is None:
        set_session_cookie(request, response, "", 0)
    return SessionDocument(
        who=asking.who,
        scopes=[scope for scope in Scope if scope in asking.scopes],
        expires_at=None,
        has_keys=not context.keys.is_empty,
        is_display=asking.key is not None and asking.key.is_display,
        keyless=context.keyless.newest()
        if context.keys.is_empty and Scope.CONFIGURE in asking.scopes
        else [],
    )


@router.delete("", status_code=204, response_class=Response, responses=problem_responses(401, 403, 429))
async def sign_out(request: Request, context: Context, asking: Asking) -> Response:
    """Sign out: end the session of this browser and of each copy of its cookie; without one, nothing happens."""
    response = Response(status_code=204)
    if asking.session is not None and asking.key is not None:
        require_own_page(request, context.settings)
        context.sessions.end(asking.session)
        who = f"key {asking.key.name}"
        await context.store.note_change(who, "session ended", asking.key.name, after={"by": who})
    set_session_cookie(request, response, "", 0)
    return response


def _document(key: AccessKey, session: BrowserSession) -> SessionDocument:
    expires_at = rfc3339(datetime.fromtimestamp(session.expires_s, UTC))
    if key.expires_at is not None:
        expires_at = min(expires_at, key.expires_at)
    return SessionDocument(
        who=f"key {key.name}",
        scopes=[Scope(each) for each in key.scopes],
        expires_at=expires_at,
        has_keys=True,
        is_display=key.is_display,
        keyless=[],
    )
