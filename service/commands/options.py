"""Commands whose options are the fields of a dataclass."""

from collections.abc import Callable
from functools import wraps
from inspect import signature
from typing import Any, TypeVar

Options = TypeVar("Options")


def with_options(command: Callable[[Options], None]) -> Callable[..., None]:
    """Return the command as typer reads it: with a parameter for each field of its dataclass of options."""
    (parameter,) = signature(command).parameters.values()
    options = parameter.annotation

    @wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        command(options(*args, **kwargs))

    run.__signature__ = signature(options)  # type: ignore[attr-defined] # inspect reads it, typeshed does not know it
    run.__annotations__ = options.__annotations__
    return run
