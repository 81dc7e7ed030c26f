"""`stonefall` by a wall clock that the test sets.

Run: python wall_clock.py FILE [arguments of stonefall]
FILE has by how many seconds it is ahead of the host's; monotonic clocks go on.
"""

import sys
from pathlib import Path

from service.commands.rehearsal.rehearsed_daemon import follow_file, set_ahead

__all__ = ["set_ahead"]

if __name__ == "__main__":
    follow_file(Path(sys.argv.pop(1)))
    from service.commands.cli import main

    main()
