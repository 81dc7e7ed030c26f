"""A wall clock that a rehearsal can set for its daemon; monotonic clocks go on."""

import sys
import time
from datetime import datetime, tzinfo
from pathlib import Path
from typing import Self

hosts_time_s = time.time


def set_ahead(path: Path, seconds: float) -> None:
    """Set the clock that follows a file, in one step."""
    unfinished = path.with_suffix(".new")
    unfinished.write_text(str(seconds))
    unfinished.rename(path)


def follow_file(path: Path) -> None:
    """Set the clock of stonefall in this process ahead by the seconds in the file."""

    def time_s() -> float:
        return hosts_time_s() + float(path.read_text())

    class Datetime(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Self:
            return cls.fromtimestamp(time_s(), tz)

    import service.daemon.run  # noqa: F401 - whose clocks are replaced

    time.time = time_s
    for name, module in list(sys.modules.items()):
        is_ours = name.startswith(("service.", "drivers.")) and name != __name__
        if is_ours and getattr(module, "datetime", None) is datetime:
            module.datetime = Datetime  # type: ignore[attr-defined]
