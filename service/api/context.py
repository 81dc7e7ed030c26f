"""The dependency of every route: what `create_app` was given, kept in the state of the application."""

from dataclasses import dataclass, field
from typing import Annotated

from fastapi import Depends, Request

from service.api.control import Control
from service.api.key_guesses import KeyGuesses
from service.api.key_ring import KeyRing
from service.api.pace import Pace
from service.api.reader_process import Reading
from service.api.settings import ApiSettings
from service.api.shared_answers import SharedAnswers
from service.store import Store


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiContext:
    """The store, the daemon and the settings that the routes work on."""

    store: Store
    control: Control
    settings: ApiSettings
    keys: KeyRing
    reading: Reading
    """Where meshes, pictures and big pages are made: clients must not take the processor from measuring."""
    shared: SharedAnswers = field(default_factory=SharedAnswers)
    waking: Pace = field(default_factory=Pace)
    """Long polls are answered one after the other, although a result wakes all of them at once."""
    guesses: KeyGuesses = field(default_factory=KeyGuesses)


def context_of(request: Request) -> ApiContext:
    context: ApiContext = request.app.state.context
    return context


Context = Annotated[ApiContext, Depends(context_of)]
