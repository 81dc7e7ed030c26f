"""Who may do what: bearer keys with scopes; without any key, everybody reads and only this machine writes."""

import hashlib
import hmac
from collections.abc import Awaitable, Callable
from ipaddress import IPv6Address, ip_address
from typing import Annotated

from fastapi import Depends, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from service.api.context import Context
from service.api.problems import Problem
from service.api.settings import ApiKey, Scope

bearer = HTTPBearer(
    auto_error=False, scheme_name="key", description="A key of the configuration, as bearer token"
)
Credentials = Annotated[HTTPAuthorizationCredentials | None, Depends(bearer)]


def require(scope: Scope) -> Callable[[Request, Context, Credentials], Awaitable[None]]:
    """Make the dependency that lets a request pass or raises the problem 401 or 403."""

    async def check(request: Request, context: Context, credentials: Credentials) -> None:
        keys = context.settings.keys
        if not keys:
            if scope is not Scope.READ and not _is_from_this_machine(request):
                raise Problem(403, "forbidden", "without any key configured only this machine may write")
            return
        if credentials is None:
            raise Problem(401, "unauthorized", "send a bearer token", headers={"WWW-Authenticate": "Bearer"})
        key = _key_of(credentials.credentials, keys)
        if key is None:
            raise Problem(
                401,
                "unauthorized",
                "this key is not known",
                headers={"WWW-Authenticate": 'Bearer error="invalid_token"'},
            )
        if scope not in key.scopes:
            raise Problem(
                403,
                "forbidden",
                f"key {key.name!r} lacks the scope {str(scope)!r}",
                headers={"WWW-Authenticate": f'Bearer error="insufficient_scope", scope="{scope}"'},
            )

    return check


def _key_of(token: str, keys: tuple[ApiKey, ...]) -> ApiKey | None:
    """Find the key without telling by the time taken how near a guess was."""
    digest = hashlib.sha256(token.encode()).hexdigest()
    matching = [key for key in keys if hmac.compare_digest(digest, key.sha256)]
    return matching[0] if matching else None


def _is_from_this_machine(request: Request) -> bool:
    """Whether both the peer and the address it asked for are loopback.

    The second stops web pages that point a name of their own at 127.0.0.1 (DNS rebinding).
    """
    if request.client is None:
        return False
    host = request.url.hostname or ""
    return _is_loopback(request.client.host) and (host == "localhost" or _is_loopback(host))


def _is_loopback(host: str) -> bool:
    try:
        address = ip_address(host)
    except ValueError:
        return False
    if isinstance(address, IPv6Address) and address.ipv4_mapped:
        return address.ipv4_mapped.is_loopback
    return address.is_loopback
