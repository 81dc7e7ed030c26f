"""`stonefall check-config`: print the settings of a configuration file, and what is wrong with them."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import tomli_w
import typer

from service.base.errors import SettingsError
from service.configuration.rig_checks import rig_warnings
from service.configuration.settings import load_settings, problems, shortcomings


def command(
    file: Annotated[Path, typer.Argument(help="Configuration file, see deploy/stonefall.toml.")],
    as_json: Annotated[
        bool, typer.Option("--json", help="Print settings, problems, warnings, and the URL here as JSON.")
    ] = False,
) -> None:
    """Print all settings of a configuration file, defaults included, and what is wrong; exit 0 if nothing is.

    A warning names a setting that is allowed but rarely intended; it is no fault.
    """
    try:
        settings = load_settings(file)
    except SettingsError as err:
        if as_json:
            typer.echo(json.dumps({"settings": None, "problems": [str(err)], "warnings": []}, indent=2))
        raise
    document = settings.model_dump(mode="json")
    wrong = [*problems(settings), *shortcomings(settings)]
    doubtful = list(rig_warnings(settings.rig))
    if as_json:
        said = {"settings": document, "problems": wrong, "warnings": doubtful}
        typer.echo(json.dumps({"url": settings.api.local_url, **said}, indent=2))
    else:
        typer.echo("\n".join(_sections(document, settings.model_dump(mode="json", exclude_none=True))))
        for problem in [*wrong, *(f"warning: {each}" for each in doubtful)]:
            typer.echo(f"stonefall: {file}: {problem}", err=True)
    if wrong:
        raise typer.Exit(1)


def _sections(document: Mapping[str, Mapping[str, Any] | None], known: Mapping[str, Any]) -> Iterator[str]:
    """Yield each section as TOML that can be read again; settings without a value are comments below its header."""
    for name, values in document.items():
        if values is None:
            yield f"# [{name}] is not set\n"
            continue
        header, *lines = tomli_w.dumps({name: known[name]}).splitlines()
        unset = [f"# {key} is not set" for key, value in values.items() if value is None]
        yield "\n".join([header, *unset, *lines, ""])
