"""The reference client of deploy/, as a module and as a process."""

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

PATH = Path(__file__).parents[2] / "deploy" / "client.py"


def _load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("stonefall_reference_client", PATH)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where its dataclasses look for it
    spec.loader.exec_module(module)
    return module


client = _load()


def start_client(url: str, database: Path, *options: str) -> subprocess.Popen[bytes]:
    """Start it as a process that follows the feed; what it says is added to a file beside its database."""
    command = ["env", "--default-signal=INT", sys.executable, PATH, url, "--db", database, *options]
    with database.with_suffix(".log").open("ab") as log:
        return subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
