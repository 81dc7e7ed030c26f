"""Options that commands share, and commands whose options are the fields of dataclasses."""

import ast
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass, is_dataclass, replace
from functools import wraps
from inspect import Parameter, Signature, getsource, signature
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import typer

from service.base.errors import UsageError

Config = Annotated[Path, typer.Option("--config", help="TOML file, see deploy/stonefall.toml.")]
DaemonConfig = Annotated[Path, typer.Option("--config", help="TOML file of the daemon.")]
Json = Annotated[bool, typer.Option("--json")]
Executor = Annotated[
    str | None,
    typer.Option(help="dask://HOST:PORT: measure on the cluster with this scheduler, instead of here."),
]
Parameters = TypeVar("Parameters", bound=Any)


@dataclass(frozen=True, slots=True)
class SizeOptions:
    """Options on the sizes of a product and what they must be."""

    lower_mm: Annotated[float | None, typer.Option(help="d of a product d/D, mm.")] = None
    upper_mm: Annotated[float | None, typer.Option(help="D of it, mm.")] = None
    specification: Annotated[str | None, typer.Option(help="Category or size, such as GC85-20.")] = None


@dataclass(frozen=True, slots=True)
class DensityOptions:
    """Density of the particles."""

    density_kg_m3: Annotated[float | None, typer.Option(min=100, max=25_000)] = None
    """Density of the particles (EN 1097-6), kg/m³."""
    density_g_cm3: Annotated[float | None, typer.Option(min=0.1, max=25, hidden=True)] = None
    """The same in g/cm³, as versions before 1.22 asked for it."""

    @property
    def given_kg_m3(self) -> float | None:
        """The density by either option, kg/m³; raises `UsageError` if both are given."""
        if self.density_kg_m3 is not None and self.density_g_cm3 is not None:
            raise UsageError("--density-kg-m3 and --density-g-cm3 are the same: give one")
        return self.density_kg_m3 if self.density_g_cm3 is None else 1000 * self.density_g_cm3


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
        flat += _documented(groups[name]) if name in groups else [own]
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


def _documented(group: type) -> Iterator[Parameter]:
    """Yield a parameter for each field: its help is the docstring of the field, and a bool alone is a flag."""
    help_texts: dict[str, str] = {}
    for part in reversed(group.__mro__[:-1]):
        for pair in pairwise(ast.walk(ast.parse(getsource(part)))):
            match pair:
                case ast.AnnAssign(target=ast.Name(name)), ast.Expr(ast.Constant(str(text))):
                    help_texts[name] = " ".join(text.split())
    kinds = get_type_hints(group)
    for each in signature(group).parameters.values():
        if each.name in help_texts:
            marks = getattr(each.annotation, "__metadata__", ())
            flag = [f"--{each.name.replace('_', '-')}"] if each.default is False else []
            mark = copy(marks[0]) if marks else typer.Option(*flag)
            mark.help = help_texts[each.name]
            each = each.replace(annotation=Annotated[kinds[each.name], mark])
        yield each
