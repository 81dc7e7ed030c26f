"""The command line as a whole: what it says of itself, and what that costs."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from service.base.errors import ServiceError
from service.commands import cli
from service.commands.cli import build_app
from service.results.version import ALGORITHM_VERSION
from service.web.version import API_VERSION

PYPROJECT = Path(__file__).parents[4] / "pyproject.toml"


def test_version_names_package_interface_and_algorithm() -> None:
    package = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]["version"]
    printed = CliRunner().invoke(build_app(()), ["--version"])
    assert (printed.exit_code, printed.stdout) == (
        0,
        f"stonefall {package}, API {API_VERSION}, algorithm {ALGORITHM_VERSION}\n",
    )


def test_version_imports_nothing_that_measures() -> None:
    code = """
import sys
from service.commands.cli import main
sys.argv[1:] = ["--version"]
try:
    main()
except SystemExit as end:
    print(end.code, *(name for name in ("numba", "fastapi", "cv2", "onnxruntime") if name in sys.modules))
"""
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    line, exit_code_and_imports = printed.splitlines()
    assert re.fullmatch(r"stonefall \S+, API \S+, algorithm \S+", line)
    assert exit_code_and_imports == "0"


@pytest.mark.parametrize(
    ("arguments", "name"),
    [(["benchmark", "--accuracy"], "benchmark"), (["models", "train", "--out", "x.onnx"], "training")],
)
def test_a_plants_installation_says_that_it_has_no_experiments(
    arguments: list[str], name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cli, "find_spec", lambda package: None if package == "research" else package)
    monkeypatch.setattr(sys, "argv", ["stonefall", *arguments])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 1
    assert capsys.readouterr().err == (
        f"stonefall: {name} is not part of a plant's installation; run it in a checkout of the repository\n"
    )


def test_a_plants_installation_lists_the_commands_that_it_has(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cli, "find_spec", lambda package: None if package == "research" else package)
    monkeypatch.setattr(sys, "argv", ["stonefall", "--help"])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 0
    printed = capsys.readouterr().out
    assert "measure" in printed and "benchmark" not in printed


def test_errors_of_tasks_are_one_line_as_those_of_a_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def command() -> None:
        gone = ServiceError("the scheduler\nis gone")
        raise BaseExceptionGroup("tasks", [ExceptionGroup("more tasks", [gone, OSError("late")])])

    monkeypatch.setattr(cli, "build_app", lambda names: command)
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 1
    assert capsys.readouterr().err == "stonefall: the scheduler is gone\n"
