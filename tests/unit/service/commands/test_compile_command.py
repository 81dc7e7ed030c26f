from pathlib import Path

import typer
from typer.testing import CliRunner, Result

from service.commands.serve import compile_command

CONFIG = """
[rig]
recording = "r"
[spool]
dir = "spool"
[store]
dir = "state"
[workers]
slots = 1
"""


def compiled(path: Path, text: str) -> Result:
    path.write_text(text)
    app = typer.Typer()
    app.command()(compile_command)
    return CliRunner().invoke(app, ["--config", str(path)])


def test_it_compiles_what_is_configured_and_touches_nothing_else(tmp_path: Path) -> None:
    result = compiled(tmp_path / "stonefall.toml", CONFIG)
    assert (result.exit_code, result.output) == (0, "")
    assert [path.name for path in tmp_path.iterdir()] == ["stonefall.toml"]
