"""Entity tags: 304 for a client that has the newest version, 412 for a change of an older one.

Both are RFC 9110, section 13. A change is compared with what is there on the thread that writes, so of two clients that
saw the same version one comes too late.
"""

import hashlib
import json
import sqlite3
from collections.abc import Callable
from typing import Annotated, Any, TypeVar

from fastapi import Header, Request, Response

from service.web.problems import Problem

T = TypeVar("T")

Responses = dict[int | str, dict[str, Any]]
NOT_MODIFIED: Responses = {304: {}}
TAGGED: Responses = {201: {"headers": {"ETag": {"$ref": "#/components/headers/ETag"}}}}

IfMatch = Annotated[
    str | None,
    Header(
        description="`ETag` of the version that you have seen: the change is made only if it is still the newest, else"
        " 412 `precondition-failed`, also where there is none yet. Without it the change is made in any case"
    ),
]


def etag(*facts: object) -> str:
    """Return the tag of a version by all that makes it one."""
    return f'"{hashlib.sha256(json.dumps(facts, sort_keys=True, default=str).encode()).hexdigest()[:16]}"'


def has_version(tags: str | None, tag: str) -> bool:
    """True when an `If-None-Match` or `If-Match` header names this version."""
    given = [each.strip().removeprefix("W/") for each in (tags or "").split(",")]
    return tag in given or "*" in given


def unchanged(request: Request, tag: str) -> Response | None:
    """Return the answer to a client that has this version already, None for any other."""
    if has_version(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers={"ETag": tag})
    return None


def change_if_match(
    connection: sqlite3.Connection,
    if_match: str | None,
    current: Callable[[sqlite3.Connection], str | None],
    change: Callable[..., T],
    *arguments: object,
) -> T:
    """Return `change(connection, *arguments)`, made only if the `current` version is one of `if_match`.

    `current` returns None for what is not there yet and the change would create. Where the change would create nothing
    it raises the 404 itself, which goes before any 412 (RFC 9110, section 13.2.1).

    Raises the problem 412 when there is another version, or none, which `If-Match: *` does not name either.
    """
    if if_match is None:
        return change(connection, *arguments)
    tag = current(connection)
    if tag is None:
        detail = "there is none of this name, or no longer: leave out If-Match to create it"
        raise Problem(412, "precondition-failed", detail)
    if not has_version(if_match, tag):
        detail = f"it was changed meanwhile and has the version {tag} now: read it again"
        raise Problem(412, "precondition-failed", detail, headers={"ETag": tag})
    return change(connection, *arguments)
