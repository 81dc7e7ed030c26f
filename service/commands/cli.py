"""The console script `stonefall`: each command is a module in `service/commands`.

A command that fails prints one line to stderr and exits with 1; wrong usage exits with 2.
"""

import sys
from collections.abc import Callable, Iterable
from importlib import import_module, metadata
from importlib.util import find_spec
from types import ModuleType
from typing import Annotated, Any

import typer

from service.processing.compiled_code import isolate_numba_cache

COMMANDS = {
    "init": "service.commands.init",
    "serve": "service.commands.serve",
    "bridge": "service.commands.bridge",
    "check-config": "service.commands.init",
    "check-host": "service.commands.doctor",
    "doctor": "service.commands.doctor",
    "diagnostics": "service.commands.doctor",
    "compile": "service.commands.serve",
    "synthesize": "service.commands.synthesize",
    "import": "service.commands.images",
    "export": "service.commands.images",
    "calibrate": "service.commands.calibrate",
    "calibration": "service.commands.calibration",
    "measure": "service.commands.measure",
    "lots": "service.commands.lots",
    "alarms": "service.commands.alarms",
    "report": "service.commands.report",
    "models": "service.commands.models",
    "record": "service.commands.record",
    "archive": "service.commands.archive",
    "audit": "service.commands.store",
    "keys": "service.commands.keys",
    "backup": "service.commands.store",
    "upgrade": "service.commands.upgrade",
    "remeasure": "service.commands.remeasure",
    "compare": "service.commands.compare",
    "restore": "service.commands.store",
    "shape": "service.commands.shape",
    "fit-volume": "service.commands.fit_volume",
    "simulate": "service.commands.simulate",
    "rehearse": "service.commands.rehearse",
    "cameras": "service.commands.cameras",
    "benchmark": "research.benchmark",
}
"""Module of each command. Its `command`, or `NAME_command` of a module that has several, is a function, whose docstring
is the help, or a `typer.Typer` of further commands.
"""


def build_app(names: Iterable[str] = COMMANDS) -> typer.Typer:
    """Build the application with these commands, importing the module of each and nothing of the others."""
    app = typer.Typer(
        name="stonefall",
        help="Photographs every stone leaving a crusher and knows its shape before it lands.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
    )
    app.callback()(_options)  # with a callback a single command stays a subcommand
    for name in names:
        module = imported(COMMANDS[name])
        command: typer.Typer | Callable[..., Any] = (
            getattr(module, f"{name.replace('-', '_')}_command", None) or module.command
        )
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name)(command)
    return app


def is_installed(module: str) -> bool:
    """True unless the module is one of `tests/research/` in a plant's installation, which has none of it."""
    return find_spec(module.partition(".")[0]) is not None


def imported(module: str) -> ModuleType:
    """Import a module by its name; raise `UsageError` where it is not installed."""
    if not is_installed(module):
        from service.base.errors import UsageError

        name = module.rpartition(".")[2]
        raise UsageError(
            f"{name} is not part of a plant's installation; run it in a checkout of the repository"
        )
    return import_module(module)


def main() -> None:
    """Run the command line; a failure that is expected becomes one line on stderr."""
    # imported here: `stonefall --help` needs none of it
    from drivers.errors import DriverError
    from pipeline.errors import PipelineError
    from service.base.errors import ServiceError

    isolate_numba_cache()
    asked_for = sys.argv[1:2]
    needed = (
        ()
        if asked_for == ["--version"]
        else [name for name in asked_for if name in COMMANDS]
        or [name for name, module in COMMANDS.items() if is_installed(module)]
    )
    expected: BaseException | None = None
    try:
        build_app(needed)()
    except* (DriverError, PipelineError, ServiceError, OSError) as group:
        expected = group
        while isinstance(expected, BaseExceptionGroup):  # of tasks: the first says it
            expected = expected.exceptions[0]
    if expected is not None:
        print(f"stonefall: {' '.join(str(expected).split())}", file=sys.stderr)  # noqa: T201 - a command's one line for people
        sys.exit(1)


def _print_version(is_wanted: bool) -> None:
    if is_wanted:
        from service.results.version import ALGORITHM_VERSION
        from service.web.version import API_VERSION

        package = metadata.version("stonefall")
        typer.echo(f"stonefall {package}, API {API_VERSION}, algorithm {ALGORITHM_VERSION}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_print_version,
            is_eager=True,
            help="Print the versions of package, REST interface and algorithm.",
        ),
    ] = False,
) -> None:
    """Declare the options of `stonefall` itself."""
