"""Errors as RFC 9457 problem details: one form for all of them, without stack traces."""

import logging
import re
from collections.abc import Callable, Mapping
from http import HTTPStatus
from typing import Any, TypeVar

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel, ConfigDict, Field
from starlette.exceptions import HTTPException
from starlette.routing import compile_path

from service.base.errors import InvalidRequestError, ProblemError, ProblemKind, StoreError
from service.base.ids import ID, ID_WORDS, NEW_ID
from service.store.trouble import TroubleCause
from service.web.request_ids import HEADER, request_id_of

log = logging.getLogger(__name__)

T = TypeVar("T")

NAMED = (
    *("alarm", "calibration", "camera", "chart", "consumer", "lot", "particle"),
    *("product", "recording", "report", "sample", "shift", "verification", "webhook"),
)
"""What requests name: each has a problem 404 of its own."""
PROBLEMS = tuple(
    ProblemKind(name, HTTPStatus(status), title)
    for status, name, title in (
        (400, "bad-request", "Bad Request"),
        (401, "unauthorized", "A valid key is needed"),
        (403, "forbidden", "Not allowed"),
        (403, "foreign-origin", "A page of another site asks for this"),
        (404, "not-kept", "This file was not kept"),
        *((404, f"unknown-{thing}", f"No such {thing}") for thing in NAMED),
        (406, "not-acceptable", "No acceptable media type"),
        (409, "request-in-progress", "The first request with this key is still being carried out"),
        (410, "files-removed", "The files of this result were removed"),
        (412, "precondition-failed", "It is not the version that If-Match names"),
        (413, "content-too-large", "The request is too large"),
        (415, "unsupported-media-type", "Not JSON"),
        (421, "unknown-host", "This service does not have the name that was asked for"),
        (422, "idempotency-key-reused", "The idempotency key was used for another request"),
        (429, "too-many-attempts", "Too many wrong keys"),
        (429, "too-many-pairings", "Too many screens wait to be signed in"),
        (429, "too-many-keys", "Too many idempotency keys"),
        (500, "internal-error", "Internal error of the service"),
        (500, "store-damaged", "The store is damaged"),
        (503, "camera-unavailable", "The camera cannot do this now"),
        (503, "not-ready", "Not ready to measure stones"),
        (503, "store-unavailable", "The store cannot be read or written"),
        (503, "too-many-connections", "Too many requests at a time"),
    )
)
"""Problems that routes raise; a `ProblemError` brings its own."""
TITLES = {kind.name: kind.title for kind in (*PROBLEMS, *InvalidRequestError.kinds)}

WAIT = frozenset({HTTPStatus.TOO_MANY_REQUESTS, HTTPStatus.SERVICE_UNAVAILABLE})
"""Statuses that always say when to come again."""
RETRY_AFTER_S = 5
MOST_ERRORS = 100
"""Most wrong fields that an answer names."""
MOST_CHARACTERS = 500
"""Longest name and longest message of a wrong field: both may repeat the request."""
LOST_PLUS = re.compile(r"\d \d\d:?\d\d$")
"""The end of a time whose `+` came as a blank."""


class FieldError(BaseModel):
    """One wrong field of a request."""

    field: str = Field(description="Where it is: `body.`, `query.`, `path.` or `header.` and its name")
    message: str = Field(description="What is wrong with it")


class ProblemDocument(BaseModel):
    """RFC 9457 problem details; further members depend on the type."""

    model_config = ConfigDict(extra="allow", title="Problem")

    type: str = Field(description="`urn:stonefall:problem:<kind>`: decide by this, or by the status")
    title: str = Field(description="The kind of problem in words")
    status: int = Field(description="HTTP status of this answer")
    detail: str = Field(description="This occurrence in words; not for programs")
    instance: str = Field(description="Path of the request")
    request_id: str | None = Field(
        default=None,
        description="The `X-Request-Id` of the request, or one made for it; the log names it. Absent when a connection"
        " was refused before its request was read",
    )
    errors: list[FieldError] = Field(
        default=[], description="With `invalid-request`: the wrong fields, 100 at most"
    )


class Problem(HTTPException):
    """An error that becomes the answer to a request. `slug` is the last part of its `type`.

    `retry_after_s` says when to come again, which 429 and 503 always do.
    """

    def __init__(
        self,
        status: int,
        slug: str,
        detail: str,
        *,
        headers: Mapping[str, str] | None = None,
        retry_after_s: int | None = None,
        title: str | None = None,
        **members: Any,
    ) -> None:
        if retry_after_s is None and status in WAIT:
            retry_after_s = RETRY_AFTER_S
        if retry_after_s is not None:
            headers = {**(headers or {}), "Retry-After": str(retry_after_s)}
            members["retry_after_s"] = retry_after_s
        super().__init__(status, detail, headers)
        self.slug = slug
        self.title = title or TITLES.get(slug, HTTPStatus(status).phrase)
        self.members = members  # of the problem object, beside those of the standard


def problem_document(problem: Problem, instance: str, request_id: str | None = None) -> dict[str, Any]:
    """Return the members of the problem details; without a `request_id` if the request was not read."""
    return {
        "type": f"urn:stonefall:problem:{problem.slug}",
        "title": problem.title,
        "status": problem.status_code,
        "detail": problem.detail,
        "instance": instance,
        **({} if request_id is None else {"request_id": request_id}),
        **problem.members,
    }


def problem_response(request: Request, problem: Problem) -> JSONResponse:
    """Return the problem as `application/problem+json`."""
    request_id = request_id_of(request)
    return JSONResponse(
        problem_document(problem, request.scope["path"], request_id),
        status_code=problem.status_code,
        headers={HEADER: request_id, **(problem.headers or {})},
        media_type="application/problem+json",
    )


def install_handlers(app: FastAPI, missing_page: Callable[[Request], Response | None]) -> None:
    """Answer every exception of a route as a problem, or an address that is not there as a page to who wants one."""

    async def answer(request: Request, error: Exception) -> Response:
        is_missing = isinstance(error, HTTPException) and error.status_code == HTTPStatus.NOT_FOUND
        if is_missing and (page := missing_page(request)) is not None:
            return page
        return problem_response(request, _problem_of_any(request, error))

    for kind in (HTTPException, RequestValidationError, ProblemError, StoreError, OSError, Exception):
        app.add_exception_handler(kind, answer)


def all_problems() -> dict[HTTPStatus, dict[str, str]]:
    """Return the title of every problem by status and kind, those of imported `ProblemError`s included."""
    errors: list[type[ProblemError]] = [ProblemError]
    for error in errors:  # to which it appends
        errors.extend(error.__subclasses__())
    found: dict[HTTPStatus, dict[str, str]] = {}
    for kind in (*PROBLEMS, *(kind for error in errors for kind in error.kinds)):
        found.setdefault(kind.status, {})[kind.name] = kind.title
    return {status: dict(sorted(titles.items())) for status, titles in sorted(found.items())}


def existing(thing: T | None, kind: str, name: str) -> T:
    """Return the thing; raise the problem 404 `unknown-<kind>` for None."""
    if thing is None:
        raise Problem(404, f"unknown-{kind}", f"there is no {kind} {name}")
    return thing


def problem_responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the statuses of problems for FastAPI; `openapi_parts` describes each once for all routes."""
    return {status: {} for status in statuses}


def invalid_request(*wrong: tuple[str, str]) -> Problem:
    """Return the problem 422 of a request, by its wrong fields and what is wrong with each."""
    errors = [{"field": field, "message": message} for field, message in wrong]
    detail = "; ".join(f"{field}: {message}" for field, message in wrong)
    return Problem(422, "invalid-request", detail, errors=errors)


def _problem_of_any(request: Request, error: Exception) -> Problem:
    """Return the problem that an exception is to the client; what only the journal may say is logged."""
    match error:
        case Problem():
            return error
        case ProblemError():
            return problem_of(error)
        case HTTPException(__cause__=UnicodeDecodeError() as err):
            detail = (
                f"a body must be UTF-8: byte 0x{err.object[err.start]:02X} at position {err.start} is not,"
                " as in Latin-1 and Windows-1252"
            )
            return Problem(400, "bad-request", detail)
        case HTTPException(status_code=status, headers=headers):
            if status == HTTPStatus.METHOD_NOT_ALLOWED:  # Starlette names those of the first route alone
                headers = {"Allow": _allowed_methods(request) or "GET"}
            slug = HTTPStatus(status).phrase.lower().replace(" ", "-")
            return Problem(status, slug, error.detail, headers=headers)
        case RequestValidationError():
            return invalid_request(*map(_wrong_field, error.errors()[:MOST_ERRORS]))
        case StoreError() | OSError():  # the latter of a disk that is full or read-only
            # the message names paths of this machine: it is for the journal, not for the client
            log.error("%s: %s", failure_of(request), error)
            trouble = request.app.state.context.store.trouble
            if trouble is not None and trouble.cause is TroubleCause.DAMAGED:  # asking again does not help
                return Problem(500, "store-damaged", str(trouble))
            return store_unavailable()
    log.error(failure_of(request), exc_info=error)
    return Problem(500, "internal-error", "unexpected error: see the journal of the service")


def _allowed_methods(request: Request) -> str:
    """Return the methods that the path of the request has in the OpenAPI document."""
    described = request.app.openapi()["paths"].items()
    fitting = [methods for path, methods in described if compile_path(path)[0].match(request.scope["path"])]
    return ", ".join(sorted({method.upper() for methods in fitting for method in methods}))


def _wrong_field(error: Mapping[str, Any]) -> tuple[str, str]:
    """Return where a wrong value is, without the type that pydantic tried for a parameter, and what is wrong."""
    place = error["loc"] if error["loc"][0] == "body" else error["loc"][:2]
    message = ID_WORDS if error.get("ctx", {}).get("pattern") in (ID, NEW_ID) else error["msg"]
    if error["loc"][0] == "query" and LOST_PLUS.search(str(error["input"])):
        message += "; a plus sign is %2B in a query"
    return _shortened(".".join(map(str, place))), _shortened(message)


def _shortened(text: str) -> str:
    return text if len(text) <= MOST_CHARACTERS else f"{text[:MOST_CHARACTERS]} ..."


def problem_of(error: ProblemError) -> Problem:
    """Return the problem that an error declares itself to be."""
    kind = next(each for each in error.kinds if each.name == error.kind)
    return Problem(
        kind.status,
        kind.name,
        str(error),
        retry_after_s=error.retry_after_s,
        title=kind.title,
        **error.members,
    )


def store_unavailable() -> Problem:
    """Return the problem of a store that cannot be read or written now."""
    return Problem(503, "store-unavailable", f"try again in {RETRY_AFTER_S} s")


def failure_of(request: Request) -> str:
    """Return the beginning of the log's line about a failed request."""
    return f"request {request_id_of(request)}: {request.method} {request.scope['path']} failed"
