"""The command line as a whole: what it says of itself, and what that costs."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

from typer.testing import CliRunner

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
