"""The background outlives the daemon: under a running crusher no moment may come to see the rig empty.

Kept for live rigs only, with what the cameras are and are set to; after a change of that nothing is restored. A
new calibration changes nothing of what they see. In replay the recording alone decides, or results would
depend on what ran before.
"""

import hashlib
import json
import logging
import shutil
import time
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from drivers.files.durable import replacing
from pipeline.frames import CameraId
from service.processing.background_files import read_background

log = logging.getLogger(__name__)

KEEP_EVERY_S = 600.0
"""It is 110 MB; dust does not settle faster."""


class KeptBackground:
    """Called from threads, one call at a time."""

    def __init__(
        self,
        folder: Path,
        image_sizes_px: Mapping[CameraId, tuple[int, int]],
        optical_settings: Sequence[Any],
    ) -> None:
        identity = hashlib.sha256(json.dumps([image_sizes_px, *optical_settings]).encode()).hexdigest()[:16]
        self._path = folder / f"background-{identity}.npz"
        self._kept_at_s: float | None = None

    def restore(self, folder: Path) -> Path | None:
        """Put the kept background where the workers read it; nothing when there is none or it is damaged."""
        if not self._path.exists():
            return None
        try:
            with zipfile.ZipFile(self._path) as archive:  # which checks what it extracts
                archive.extractall(folder)
            read_background(folder)
        except (OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile) as err:
            log.error("the kept background is not used: %s file=%s", err, self._path)
            shutil.rmtree(folder, ignore_errors=True)
            return None
        log.info("background of before restored file=%s", self._path)
        return folder

    def keep(self, folder: Path) -> None:
        """Keep a background for the next start, unless that was done lately; a full disk costs only this."""
        now_s = time.monotonic()
        if self._kept_at_s is not None and now_s - self._kept_at_s < KEEP_EVERY_S:
            return
        self._kept_at_s = now_s
        try:
            with replacing(self._path) as unfinished, zipfile.ZipFile(unfinished, "w") as archive:
                for path in sorted(folder.iterdir()):  # as numpy.savez would, and earlier releases did
                    # at once: in zipfile's own pieces of 8 kB the interpreter's lock changes hands all the time
                    archive.writestr(path.name, path.read_bytes())
            for other in self._path.parent.glob("background-*.npz"):
                if other != self._path:
                    other.unlink()
        except OSError as err:
            log.error("the background is not kept for the next start: %s file=%s", err, self._path)
