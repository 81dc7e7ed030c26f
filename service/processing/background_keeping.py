"""Keep the background for the next start of the daemon: a running crusher may never show the rig empty.

Kept for live rigs only, under a hash of the cameras and their settings; after a change of these nothing is restored.
A new calibration changes nothing about the images. In replay nothing is kept, or results would depend on what
ran before.
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
"""Shortest time between two writes of the 110 MB; dust settles more slowly than that."""


class KeptBackground:
    """The background file that outlives the daemon; called from threads, one call at a time."""

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
        """Extract the kept background into `folder` and return that; None when there is none or it is damaged."""
        if not self._path.exists():
            return None
        try:
            with zipfile.ZipFile(self._path) as archive:  # extracting verifies checksums
                archive.extractall(folder)
            read_background(folder)
        except (OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile) as err:
            log.error("the kept background is damaged and not used: %s file=%s", err, self._path)
            shutil.rmtree(folder, ignore_errors=True)
            return None
        log.info("kept background restored file=%s", self._path)
        return folder

    def keep(self, folder: Path) -> None:
        """Keep a background for the next start, at most every `KEEP_EVERY_S`; a full disk is logged, not raised."""
        now_s = time.monotonic()
        if self._kept_at_s is not None and now_s - self._kept_at_s < KEEP_EVERY_S:
            return
        self._kept_at_s = now_s
        try:
            with replacing(self._path) as unfinished, zipfile.ZipFile(unfinished, "w") as archive:
                for path in sorted(
                    folder.iterdir()
                ):  # the format of numpy.savez, which earlier releases used
                    # whole files: with zipfile's pieces of 8 kB the interpreter's lock changes hands all the time
                    archive.writestr(path.name, path.read_bytes())
            for other in self._path.parent.glob("background-*.npz"):
                if other != self._path:
                    other.unlink()
        except OSError as err:
            log.error("the background is not kept for the next start: %s file=%s", err, self._path)
