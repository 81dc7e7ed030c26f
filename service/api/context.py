"""The dependency of every route: what `create_app` was given, kept in the state of the application."""

import asyncio
from dataclasses import dataclass, field
from typing import Annotated

from fastapi import Depends, Request

from service.api.control import Control
from service.api.key_guesses import KeyGuesses
from service.api.settings import ApiSettings
from service.store import Store


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiContext:
    """The store, the daemon and the settings that the routes work on."""

    store: Store
    control: Control
    settings: ApiSettings
    rendering: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(1))
    """Meshes and images are converted one at a time: clients must not take the processor from measuring."""
    guesses: KeyGuesses = field(default_factory=KeyGuesses)


def context_of(request: Request) -> ApiContext:
    context: ApiContext = request.app.state.context
    return context


Context = Annotated[ApiContext, Depends(context_of)]
