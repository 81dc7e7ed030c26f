"""Authorization by bearer keys with scopes.

While there is no key, only this machine may write, and other hosts may read if `[api] without_keys` says so.
"""

import logging
import math
import time
from collections.abc import Awaitable, Callable
from typing import Annotated

from fastapi import Depends, Request, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from drivers.files.times import utc_now
from service.addresses import host_of, is_loopback
from service.api.context import ApiContext, Context
from service.api.idempotency import begin_attempt
from service.api.key_file import StoredKey
from service.api.key_ring import KeyRing, note_keys
from service.api.problems import Problem
from service.api.settings import Scope
from service.errors import StoreError

log = logging.getLogger(__name__)

THIS_MACHINE = "this machine"
"""Who asks while there is no key."""
INVALID_TOKEN = {"WWW-Authenticate": 'Bearer error="invalid_token"'}

bearer = HTTPBearer(
    auto_error=False,
    scheme_name="key",
    description="The token that `stonefall keys create` printed, or of a key in the configuration, as bearer token",
)
Credentials = Annotated[HTTPAuthorizationCredentials | None, Depends(bearer)]


def require(scope: Scope) -> Callable[[Request, Context, Credentials], Awaitable[None]]:
    """Return the dependency that raises the problem 401 or 403 for a request without a key of this scope."""

    async def check(request: Request, context: Context, credentials: Credentials) -> None:
        keys = await _keys_now(context)
        if keys.is_empty:
            _check_without_keys(request, context, scope)
            request.state.who = THIS_MACHINE
            return
        if credentials is None:
            raise Problem(
                401,
                "unauthorized",
                "send the token of a key as bearer token",
                headers={"WWW-Authenticate": "Bearer"},
            )
        key = keys.find(credentials.credentials)
        host, now_s, guesses = _host_of(request), time.monotonic(), context.guesses
        if (pause_s := guesses.pause_s(host, None if key is None else key.name, now_s)) > 0:
            wait_s = math.ceil(pause_s)
            raise Problem(
                429,
                "too-many-attempts",
                f"too many wrong keys came from {host}: try again in {wait_s} s",
                retry_after_s=wait_s,
            )
        if key is None:
            guesses.note_wrong(host, now_s)
            raise Problem(401, "unauthorized", "there is no such key", headers=INVALID_TOKEN)
        if isinstance(key, StoredKey) and (refusal := key.refusal(utc_now())) is not None:
            raise Problem(
                401, "unauthorized", refusal, headers=INVALID_TOKEN
            )  # whose token it is, that is no guess
        guesses.note_right(host, key.name)
        if scope not in key.scopes:
            raise Problem(
                403,
                "forbidden",
                f"key {key.name!r} lacks the scope {str(scope)!r}",
                headers={"WWW-Authenticate": f'Bearer error="insufficient_scope", scope="{scope}"'},
            )
        request.state.who = f"key {key.name}"

    async def admit(
        request: Request,
        context: Context,
        credentials: Annotated[HTTPAuthorizationCredentials | None, Security(bearer, scopes=[scope])],
    ) -> None:
        await check(request, context, credentials)
        await begin_attempt(request)

    return admit


def who(request: Request) -> str:
    """Return who asks, for the audit; on a route that requires a scope."""
    return str(request.state.who)


Who = Annotated[str, Depends(who)]


async def _keys_now(context: ApiContext) -> KeyRing:
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


def _check_without_keys(request: Request, context: ApiContext, scope: Scope) -> None:
    if _is_from_this_machine(request):
        return
    if scope is not Scope.READ:
        raise Problem(403, "forbidden", "only this machine may do this while there is no key")
    if not context.settings.may_read_without_keys:
        detail = "there is no key yet: only this machine may ask; `stonefall keys create` makes one"
        raise Problem(401, "unauthorized", detail, headers={"WWW-Authenticate": "Bearer"})


def _is_from_this_machine(request: Request) -> bool:
    """Return whether both the peer and the host name it asked for are loopback.

    A proxy on this machine is a peer on loopback, too, but passes on the name that its clients asked for.
    """
    return is_loopback(_host_of(request)) and is_loopback(host_of(request.headers.get("host", "")))


def _host_of(request: Request) -> str:
    """Return the address of the client, empty when the server does not know it."""
    return "" if request.client is None else request.client.host
