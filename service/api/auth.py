"""Authorization by bearer keys with scopes.

While no key is configured, every host may read and only this machine may write.
"""

import hashlib
import hmac
import math
import time
from collections.abc import Awaitable, Callable
from typing import Annotated

from fastapi import Depends, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from service.api.addresses import host_of, is_loopback
from service.api.context import Context
from service.api.problems import Problem
from service.api.settings import ApiKey, Scope

THIS_MACHINE = "this machine"
"""Who asks while no key is configured."""

bearer = HTTPBearer(
    auto_error=False,
    scheme_name="key",
    description="The token of a key that `[api] keys` of the configuration lists, sent as bearer token",
)
Credentials = Annotated[HTTPAuthorizationCredentials | None, Depends(bearer)]


def require(scope: Scope) -> Callable[[Request, Context, Credentials], Awaitable[None]]:
    """Return the dependency that raises the problem 401 or 403 for a request without a key of this scope."""

    async def check(request: Request, context: Context, credentials: Credentials) -> None:
        keys = context.settings.keys
        if not keys:
            if scope is not Scope.READ and not _is_from_this_machine(request):
                raise Problem(403, "forbidden", "only this machine may write while no key is configured")
            request.state.who = THIS_MACHINE
            return
        if credentials is None:
            raise Problem(
                401,
                "unauthorized",
                "send the token of a key as bearer token",
                headers={"WWW-Authenticate": "Bearer"},
            )
        key = _key_of(credentials.credentials, keys)
        host, now_s, guesses = _host_of(request), time.monotonic(), context.guesses
        if (pause_s := guesses.pause_s(host, None if key is None else key.name, now_s)) > 0:
            wait_s = math.ceil(pause_s)
            raise Problem(
                429,
                "too-many-attempts",
                f"too many wrong keys came from {host}: try again in {wait_s} s",
                headers={"Retry-After": str(wait_s)},
                retry_after_s=wait_s,
            )
        if key is None:
            guesses.note_wrong(host, now_s)
            raise Problem(
                401,
                "unauthorized",
                "the key is not one of the configured keys",
                headers={"WWW-Authenticate": 'Bearer error="invalid_token"'},
            )
        guesses.note_right(host, key.name)
        if scope not in key.scopes:
            raise Problem(
                403,
                "forbidden",
                f"key {key.name!r} lacks the scope {str(scope)!r}",
                headers={"WWW-Authenticate": f'Bearer error="insufficient_scope", scope="{scope}"'},
            )
        request.state.who = f"key {key.name}"

    return check


def who(request: Request) -> str:
    """Return who asks, for the audit; on a route that requires a scope."""
    return str(request.state.who)


Who = Annotated[str, Depends(who)]


def _key_of(token: str, keys: tuple[ApiKey, ...]) -> ApiKey | None:
    """Return the key of a token; compared in constant time, so that timing does not tell how near a guess was."""
    digest = hashlib.sha256(token.encode()).hexdigest()
    matching = [key for key in keys if hmac.compare_digest(digest, key.sha256)]
    return matching[0] if matching else None


def _is_from_this_machine(request: Request) -> bool:
    """Return whether both the peer and the host name it asked for are loopback.

    A proxy on this machine is a peer on loopback, too, but passes on the name that its clients asked for.
    """
    return is_loopback(_host_of(request)) and is_loopback(host_of(request.headers.get("host", "")))


def _host_of(request: Request) -> str:
    """Return the address of the client, empty when the server does not know it."""
    return "" if request.client is None else request.client.host
