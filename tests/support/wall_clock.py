"""`stonefall` by a wall clock that the test sets.

Run: python wall_clock.py FILE [arguments of stonefall]
FILE has by how many seconds it is ahead of the host's; monotonic clocks go on.
"""

import sys
import time
from datetime import datetime, tzinfo
from pathlib import Path
from typing import Self

hosts_time_s = time.time


def set_ahead(path: Path, seconds: float) -> None:
    """Set the clock, in one step."""
    unfinished = path.with_suffix(".new")
    unfinished.write_text(str(seconds))
    unfinished.rename(path)


def main() -> None:
    path = Path(sys.argv.pop(1))

    def time_s() -> float:
        return hosts_time_s() + float(path.read_text())

    class Datetime(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Self:
            return cls.fromtimestamp(time_s(), tz)

    import service.daemon.run  # noqa: F401 - whose clocks are replaced
    from service.cli import main as stonefall

    time.time = time_s
    for name, module in list(sys.modules.items()):
        if name.startswith(("service.", "drivers.")) and getattr(module, "datetime", None) is datetime:
            module.datetime = Datetime  # type: ignore[attr-defined]
    stonefall()


if __name__ == "__main__":
    main()
