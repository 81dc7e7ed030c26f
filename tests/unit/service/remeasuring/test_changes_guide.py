"""The guide says what each version of the algorithm changed in results, and the commands that compare them name it."""

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from service.commands.cli import build_app
from service.results.version import ALGORITHM_VERSION, CHANGES

ROOT = Path(__file__).parents[4]


def test_each_version_of_the_algorithm_has_its_row() -> None:
    rows = re.findall(
        r"^\| (\d+) \| (.+) \| (.+) \|$", (ROOT / CHANGES).read_text(encoding="utf-8"), re.MULTILINE
    )
    versions = [int(version) for version, _, _ in rows]
    assert versions == list(range(1, int(ALGORITHM_VERSION) + 1)), f"{CHANGES} needs a row for each version"


@pytest.mark.parametrize("command", ["remeasure", "compare"])
def test_help_of_the_commands_names_the_guide(command: str) -> None:
    done = CliRunner().invoke(build_app([command]), [command, "--help"], env={"COLUMNS": "200"})
    assert CHANGES in done.output
