"""The commands that compare versions of the algorithm name the guide to them."""

import pytest
from typer.testing import CliRunner

from service.commands.cli import build_app
from service.results.version import CHANGES_GUIDE


@pytest.mark.parametrize("command", ["remeasure", "compare"])
def test_help_of_the_commands_names_the_guide(command: str) -> None:
    done = CliRunner().invoke(build_app([command]), [command, "--help"], env={"COLUMNS": "200"})
    assert CHANGES_GUIDE in done.output
