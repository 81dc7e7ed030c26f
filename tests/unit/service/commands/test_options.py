"""A command of a dataclass of options is, on the command line, one of as many parameters."""

from dataclasses import dataclass
from typing import Annotated

import typer
from typer.testing import CliRunner

from service.commands.options import with_options

Rate = Annotated[float, typer.Option("--rate", min=1, help="Stones per second.")]


@dataclass(frozen=True)
class Options:
    out: Annotated[str, typer.Argument(help="Folder.")]
    rate: Rate = 4.0
    loop: Annotated[bool, typer.Option("--loop", help="Begin again.")] = False


@with_options
def grouped(options: Options) -> None:
    """Record stones."""
    typer.echo(f"{options.out} {options.rate} {options.loop}")


@dataclass(frozen=True, slots=True)
class DocumentedOptions:
    out: Annotated[str, typer.Argument()]
    """Folder."""
    rate: Annotated[float, typer.Option("--rate", min=1)] = 4.0
    """Stones per
    second.
    """
    loop: bool = False
    """Begin again."""


@with_options
def documented(options: DocumentedOptions) -> None:
    """Record stones."""
    typer.echo(f"{options.out} {options.rate} {options.loop}")


def spread(
    out: Annotated[str, typer.Argument(help="Folder.")],
    rate: Rate = 4.0,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again.")] = False,
) -> None:
    """Record stones."""
    typer.echo(f"{out} {rate} {loop}")


def test_help_values_and_refusals_are_the_same() -> None:
    for words in (["--help"], ["here"], ["here", "--rate", "2", "--loop"], ["here", "--rate", "0"], []):
        printed = []
        for command in (spread, grouped, documented):
            app = typer.Typer()
            app.command("record")(command)
            result = CliRunner().invoke(app, words)
            printed.append((result.exit_code, result.output))
        assert printed == printed[:1] * 3, words


def test_it_can_be_called_as_the_function_of_as_many_parameters() -> None:
    assert grouped("here", loop=True) is None
