"""Errors as RFC 9457 problem details: one shape for everything that is not a success, and no stack traces."""

import logging
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any, TypeVar

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.routing import compile_path

from service.calibration.states import CalibrationConflictError
from service.errors import StoreError
from service.status import ConflictError

log = logging.getLogger(__name__)

T = TypeVar("T")

TITLES = {
    "calibration-conflict": "This cannot be done with a calibration now",
    "cursor-ahead": "The cursor is ahead of the history",
    "cursor-expired": "The cursor is older than what is kept",
    "forbidden": "Not allowed",
    "internal-error": "A fault of the service",
    "content-too-large": "The request is too large",
    "invalid-request": "The request is not valid",
    "no-room": "The disk has no room for it",
    "not-acceptable": "No acceptable representation",
    "not-kept": "This file was not kept",
    "not-ready": "Not ready to measure stones",
    "recording-exists": "There is such a recording already",
    "recording-running": "Another recording is under way",
    "store-unavailable": "The store cannot be read or written",
    "transition-conflict": "The acquisition cannot change to this state now",
    "unauthorized": "A key is needed",
    "unknown-calibration": "No such calibration",
    "unknown-camera": "No such camera",
    "unknown-particle": "No such particle",
    "unknown-recording": "No such recording",
    "unknown-verification": "No such verification",
}


class Problem(HTTPException):
    """An answer other than success, raised where it is found out."""

    def __init__(
        self,
        status: int,
        slug: str,
        detail: str,
        *,
        headers: Mapping[str, str] | None = None,
        **members: Any,
    ) -> None:
        super().__init__(status, detail, headers)
        self.slug = slug
        self.members = members  # further members of the problem object, beside the standard's


def problem_response(request: Request, problem: Problem) -> JSONResponse:
    """Write the problem as `application/problem+json`."""
    return JSONResponse(
        {
            "type": f"urn:stonefall:problem:{problem.slug}",
            "title": TITLES.get(problem.slug, HTTPStatus(problem.status_code).phrase),
            "status": problem.status_code,
            "detail": problem.detail,
            "instance": request.scope["path"],
            **problem.members,
        },
        status_code=problem.status_code,
        headers=problem.headers,
        media_type="application/problem+json",
    )


def install_handlers(app: FastAPI) -> None:
    """Turn every exception that can leave a route into a problem."""
    app.add_exception_handler(HTTPException, _of_http)
    app.add_exception_handler(RequestValidationError, _of_validation)
    app.add_exception_handler(ConflictError, _of_conflict)
    app.add_exception_handler(CalibrationConflictError, _of_calibration)
    app.add_exception_handler(StoreError, _of_store)
    app.add_exception_handler(Exception, _of_bug)


def found(thing: T | None, kind: str, name: str) -> T:
    """Return the thing; where there is none the answer is 404, `unknown-<kind>`."""
    if thing is None:
        raise Problem(404, f"unknown-{kind}", f"there is no {kind} {name}")
    return thing


def documented(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Describe for OpenAPI that a route answers with these problems, and any route with some."""
    schema = {"$ref": "#/components/schemas/Problem"}
    content = {"application/problem+json": {"schema": schema}}
    return {
        **{status: {"description": HTTPStatus(status).phrase, "content": content} for status in statuses},
        "default": {"description": "Any other error", "content": content},
    }


async def _of_http(request: Request, error: Exception) -> JSONResponse:
    if isinstance(error, Problem):
        return problem_response(request, error)
    assert isinstance(error, HTTPException)  # noqa: S101 - the handler's registration says so, the type cannot
    slug = HTTPStatus(error.status_code).phrase.lower().replace(" ", "-")
    headers = error.headers
    if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
        headers = {"Allow": _methods_of(request) or "GET"}  # Starlette names those of the first route alone
    return problem_response(request, Problem(error.status_code, slug, error.detail, headers=headers))


def _methods_of(request: Request) -> str:
    """What the path of the request can be asked with, if it is described."""
    described = request.app.openapi()["paths"].items()
    fitting = [methods for path, methods in described if compile_path(path)[0].match(request.scope["path"])]
    return ", ".join(sorted({method.upper() for methods in fitting for method in methods}))


async def _of_validation(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)  # noqa: S101 - as above
    errors = [
        {"field": ".".join(map(str, _place(item["loc"]))), "message": item["msg"]} for item in error.errors()
    ]
    detail = "; ".join(f"{item['field']}: {item['message']}" for item in errors)
    return problem_response(request, Problem(422, "invalid-request", detail, errors=errors))


def _place(location: Sequence[str | int]) -> Sequence[str | int]:
    """Where the value is; pydantic adds which of several types a parameter is not."""
    return location if location[0] == "body" else location[:2]


async def _of_conflict(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, ConflictError)  # noqa: S101 - as above
    return problem_response(
        request, Problem(409, "transition-conflict", str(error), current=error.current, target=error.target)
    )


async def _of_calibration(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, CalibrationConflictError)  # noqa: S101 - as above
    return problem_response(request, Problem(409, "calibration-conflict", str(error), state=error.state))


async def _of_store(request: Request, error: Exception) -> JSONResponse:
    # the message names paths of this machine: it belongs into the journal, not into the answer
    log.error("%s %s failed: %s", request.method, request.scope["path"], error)
    return problem_response(
        request, Problem(503, "store-unavailable", "try again", headers={"Retry-After": "5"}, retry_after_s=5)
    )


async def _of_bug(request: Request, error: Exception) -> JSONResponse:
    log.error("%s %s failed", request.method, request.scope["path"], exc_info=error)
    return problem_response(request, Problem(500, "internal-error", "the journal of the service says more"))
