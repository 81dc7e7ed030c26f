"""Parameters that routes of several rooms take, and the refusal of those that a route does not know."""

from collections.abc import Collection
from difflib import get_close_matches
from typing import Annotated

from fastapi import Depends, Path, Query, Request
from fastapi.dependencies.models import Dependant
from pydantic import BaseModel

from service.web.problems import invalid_request

CameraName = Annotated[
    str, Path(pattern=r"^[A-Za-z0-9_-]{1,64}$", description="Place of the camera in the rig, such as `c01`")
]


async def _take_time(
    at: Annotated[
        str | None,
        Query(
            max_length=40,
            description="Anything: another address, so that a browser asks for the newest picture",
        ),
    ] = None,
) -> None: ...


ANEW = Depends(_take_time)
"""Takes a word that changes nothing but the address."""


async def only_known_words(request: Request) -> None:
    """Raise the problem 422 for a word of the query that the route does not know: a typing error changes no answer.

    So it does for a value that is not UTF-8, which would find nothing.
    """
    known = _words_of(request.scope["route"].dependant) if request.query_params else ()
    wrong = [(word, _unknown(word, known)) for word in request.query_params if word not in known]
    wrong += [
        (f"query.{word}", "must be UTF-8, each byte of an umlaut as % and two digits")
        for word, value in request.query_params.multi_items()
        if "\ufffd" in value  # in the place of what could not be decoded
    ]
    if wrong:
        raise invalid_request(*wrong)


def _words_of(dependant: Dependant) -> frozenset[str]:
    """Return the words of a query that a route and what it depends on take; a model of them stands for its fields."""
    own: set[str] = set()
    for parameter in dependant.query_params:
        kind = parameter.field_info.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            own.update(kind.model_fields)
        else:
            own.add(parameter.alias)
    return frozenset(own).union(*map(_words_of, dependant.dependencies))


def _unknown(word: str, known: Collection[str]) -> str:
    near = get_close_matches(word, known, n=1)
    there_are = f"there are {', '.join(sorted(known))}" if known else "there are none here"
    return f"is no word of this query; {f'did you mean {near[0]}?' if near else there_are}"
