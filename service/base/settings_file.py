"""A settings file: TOML, bounded, checked by a pydantic model, every wrong field named."""

import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from drivers.files.bounded import read_bounded
from service.base.errors import SettingsError

MAX_BYTES = 1_000_000
"""Largest configuration file."""
MAX_LINE = 20_000
"""Longest line in characters: a key of many parts takes time by the square of their number."""

Loc = tuple[int | str, ...]
Model = TypeVar("Model", bound=BaseModel)


def dotted(loc: Loc) -> str:
    """Return the name of a field as `section.name`."""
    return ".".join(map(str, loc))


def load_settings_file(path: Path, model: type[Model], name_of: Callable[[Loc], str] = dotted) -> Model:
    """Read and check a settings file; relative paths in it start at its folder.

    Raises `SettingsError`, which names the file and each wrong field.
    """
    document = read_toml(path)
    try:
        settings = model.model_validate(document, context={"folder": path.resolve().parent})
    except ValidationError as err:
        raise SettingsError(f"{path}: {wrong_fields(err, name_of)}") from None
    if wrong := "; ".join(_truths_as_numbers(document, settings, name_of)):
        raise SettingsError(f"{path}: {wrong}")
    return settings


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file, bounded; raise `SettingsError`, which names it."""
    try:
        text = read_bounded(path, MAX_BYTES).decode()
        if any(len(line) > MAX_LINE for line in text.splitlines()):
            raise ValueError(f"has a line of more than {MAX_LINE} characters")
        return tomllib.loads(text)
    except OSError as err:
        raise SettingsError(f"{path}: {err.strerror}") from err
    except ValueError as err:  # neither text nor TOML, or a number beyond all bounds
        raise SettingsError(f"{path}: {err}") from err
    except RecursionError as err:
        raise SettingsError(f"{path}: is nested too deeply") from err


def wrong_fields(err: ValidationError, name_of: Callable[[Loc], str] = dotted, *section: str) -> str:
    """Return the fields that are wrong, each with the reason; `section` is the one that was validated alone."""
    return "; ".join(
        ": ".join(
            [*filter(None, [name_of((*section, *error["loc"]))]), error["msg"].removeprefix("Value error, ")]
        )
        for error in err.errors()
    )


def _truths_as_numbers(
    given: object, made: object, name_of: Callable[[Loc], str], *loc: int | str
) -> Iterator[str]:
    """Yield the settings that are numbers but were given as true or false, which pydantic takes for 1 or 0."""
    if isinstance(given, bool) and isinstance(made, int | float) and not isinstance(made, bool):
        yield f"{name_of(loc)}: must be a number, not {str(given).lower()}"
    elif isinstance(given, dict):
        for name, value in given.items():
            yield from _truths_as_numbers(value, getattr(made, name, None), name_of, *loc, name)
    elif isinstance(given, list) and isinstance(made, tuple | list):
        for place, (value, each) in enumerate(zip(given, made, strict=False)):
            yield from _truths_as_numbers(value, each, name_of, *loc, place)
