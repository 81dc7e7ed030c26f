"""`stonefall check-config`: what a configuration file comes to, and what is wrong with it."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from service.configuration.settings import load_settings, problems, shortcomings
from service.errors import SettingsError


def command(
    file: Annotated[Path, typer.Argument(help="TOML file.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print settings and problems as JSON.")] = False,
) -> None:
    """Print the resolved settings and what is wrong with them; exit 0 if nothing is."""
    try:
        settings = load_settings(file)
    except SettingsError as err:
        if as_json:
            typer.echo(json.dumps({"settings": None, "problems": [str(err)]}, indent=2))
        raise
    document = settings.model_dump(mode="json")
    wrong = [*problems(settings), *shortcomings(settings)]
    if as_json:
        typer.echo(json.dumps({"settings": document, "problems": wrong}, indent=2))
    else:
        for line in _as_toml(document):
            typer.echo(line)
        for problem in wrong:
            typer.echo(f"stonefall: {file}: {problem}", err=True)
    if wrong:
        raise typer.Exit(1)


def _as_toml(document: dict[str, dict[str, Any]]) -> Iterator[str]:
    """Show the settings the way they are written; a value that is not set is a comment."""
    for section, values in document.items():
        yield f"[{section}]"
        for name, value in values.items():
            yield f"# {name} is not set" if value is None else f"{name} = {_toml(value)}"
        yield ""


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        pairs = (f"{name} = {_toml(each)}" for name, each in value.items() if each is not None)
        return f"{{ {', '.join(pairs)} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(value)
