"""Options that commands share, and commands whose options are the fields of dataclasses."""

from collections.abc import Callable
from dataclasses import dataclass, is_dataclass, replace
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

Config = Annotated[Path, typer.Option("--config", help="TOML file, see deploy/stonefall.toml.")]
DaemonConfig = Annotated[Path, typer.Option("--config", help="TOML file of the daemon.")]
Parameters = TypeVar("Parameters", bound=Any)


@dataclass(frozen=True, slots=True)
class SizeOptions:
    """Options on the sizes of a product and what they must be."""

    lower_mm: Annotated[float | None, typer.Option(help="d of a product d/D, mm.")] = None
    upper_mm: Annotated[float | None, typer.Option(help="D of it, mm.")] = None
    specification: Annotated[str | None, typer.Option(help="Category or size, such as GC85-20.")] = None


def changed(parameters: Parameters, **options: Any) -> Parameters:
    """Return the parameters with those options that the command line has."""
    return replace(parameters, **{name: value for name, value in options.items() if value is not None})


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command as typer reads it: with a parameter for each field of a parameter that is a dataclass."""
    parameters = signature(command).parameters
    groups: dict[str, Any] = {
        name: each.annotation for name, each in parameters.items() if is_dataclass(each.annotation)
    }
    flat: list[Parameter] = []
    for name, each in parameters.items():
        own = each.replace(kind=Parameter.POSITIONAL_OR_KEYWORD)
        flat += signature(groups[name]).parameters.values() if name in groups else [own]
    shown = Signature(flat)

    @wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        given = shown.bind(*args, **kwargs).arguments
        for name, group in groups.items():
            given[name] = group(
                **{each: given.pop(each) for each in signature(group).parameters if each in given}
            )
        command(**given)

    run.__signature__ = shown  # type: ignore[attr-defined] # inspect reads it, typeshed does not know it
    run.__annotations__ = {each.name: each.annotation for each in flat}
    return run
