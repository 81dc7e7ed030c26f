"""An outlet of the bridge that stores results as the reference client does, and the bridge with it, as a process.

python tests/support/recording_outlet.py CONFIG    # of a bridge; [modbus] stands for the outlet
"""

import subprocess
import sys
from contextlib import closing
from pathlib import Path

import tomli_w

if __package__ is None:
    sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2])]

from service.bridge.plant import Plant
from service.bridge.reference_client import Database

DATABASE = "stones.sqlite"


async def run(_: object, plant: Plant) -> None:
    """Store each result, in a database whose cursor is not used: the bridge has its own."""
    with closing(Database(plant.folder / DATABASE)) as database:
        async for step in plant.results("recorder", fields=None):
            database.store(step)


def start_bridge(url: str, folder: Path) -> subprocess.Popen[bytes]:
    """Start the bridge in a folder; its log is appended to a file there, of the database's name."""
    folder.mkdir(exist_ok=True)
    config = {"dir": ".", "daemon": {"url": url, "consumer": "bridge"}, "modbus": {}}
    (folder / "bridge.toml").write_text(tomli_w.dumps(config))
    command = ["env", "--default-signal=INT", sys.executable, __file__, folder / "bridge.toml"]
    with (folder / DATABASE).with_suffix(".log").open("ab") as log:
        return subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)


if __name__ == "__main__":
    from service.bridge import settings
    from service.commands.bridge import command

    settings.OUTLETS["modbus"] = "support.recording_outlet"
    command(Path(sys.argv[1]))
