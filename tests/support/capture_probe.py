"""`stonefall` whose daemon notes when each bundle is complete.

Run: python capture_probe.py FILE [arguments of stonefall]
A line of FILE is a bundle: the time from the edge of the gate, as the daemon dates it, to its complete bundle (ms), and
the number of its frames.
"""

import sys
import time
from pathlib import Path

from pipeline.frames import BundleKind, FrameBundle
from service.processing.spool import Spool


def note_bundles(path: Path) -> None:
    """Have the spool note what is offered to it."""
    offer, file = Spool.offer, path.open("a", encoding="utf-8", buffering=1)

    def noted(spool: Spool, bundle: FrameBundle) -> None:
        if bundle.trigger.kind is BundleKind.PARTICLE:
            waited_ms = (time.monotonic_ns() - bundle.trigger.received_ns) / 1e6
            file.write(f"{waited_ms:.2f} {len(bundle.frames)}\n")
        offer(spool, bundle)

    Spool.offer = noted  # type: ignore[method-assign]


def main() -> None:
    from service.commands.cli import main as stonefall  # the workers import this module, too

    note_bundles(Path(sys.argv.pop(1)))
    stonefall()


if __name__ == "__main__":
    main()
