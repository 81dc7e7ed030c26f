"""The console script `stonefall`: one command a module in `service/commands`.

A command's failure is one clear line on stderr and exit code 1; wrong usage exits with 2.
"""

import sys
from collections.abc import Callable, Iterable
from importlib import import_module
from typing import Any

import typer

from service.compiled_code import isolate_numba_cache

COMMANDS = {
    "serve": "service.commands.serve",
    "check-config": "service.commands.check_config",
    "compile": "service.commands.compile",
    "synthesize": "service.commands.synthesize",
    "import": "service.commands.import_images",
    "export": "service.commands.export_images",
    "calibrate": "service.commands.calibrate",
    "calibration": "service.commands.calibration",
    "measure": "service.commands.measure",
    "models": "service.commands.models",
    "record": "service.commands.record",
    "shape": "service.commands.shape",
    "fit-volume": "service.commands.fit_volume",
    "simulate": "service.commands.simulate",
    "cameras": "service.commands.cameras",
    "benchmark": "service.commands.benchmark",
}
"""Each module has one function `command`, whose docstring is its help; or several of them in a `typer.Typer`."""


def build_app(names: Iterable[str] = COMMANDS) -> typer.Typer:
    """The application with these commands; each costs the import of what it needs."""
    app = typer.Typer(
        name="stonefall",
        help="Photographs every stone leaving a crusher and knows its shape before it lands.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
    )
    app.callback()(lambda: None)  # a single command stays a subcommand
    for name in names:
        command: typer.Typer | Callable[..., Any] = import_module(COMMANDS[name]).command
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name)(command)
    return app


def main() -> None:
    """Run the command line; expected failures become one line on stderr."""
    # imported here: `stonefall --help` needs none of it
    from drivers.errors import DriverError
    from pipeline.errors import PipelineError
    from service.errors import ServiceError

    isolate_numba_cache()
    wanted = [name for name in sys.argv[1:2] if name in COMMANDS]
    try:
        build_app(wanted or COMMANDS)()
    except (DriverError, PipelineError, ServiceError, OSError) as err:
        print(f"stonefall: {' '.join(str(err).split())}", file=sys.stderr)  # noqa: T201 - a command's one line for people
        sys.exit(1)
