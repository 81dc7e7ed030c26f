"""Read, write and keep background models: one folder a version, never rewritten under its name.

Every array is a file in numpy's format, `<camera>.npy` the mean and others beside it. They are mapped: the means
of 16 cameras are 84 MB, which all workers share. What segmentation derives from whole means is stored as well:
otherwise each worker would compute it anew after each exposure of the empty rig, while a stone waits.

The newest background is kept for the next start of the daemon: a running crusher may never show the rig empty.
For live rigs only, under a hash of the cameras and their settings; after a change of these nothing is restored.
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
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.files.durable import replacing
from pipeline.frames import CameraId
from pipeline.segmentation import BackgroundModel
from pipeline.segmentation.background import CameraBackground

log = logging.getLogger(__name__)

COUNTS, REFUSED, CLEAN = ".counts", ".refused", ".clean"
"""Endings of the names of arrays beside a camera's mean; a camera id has no dot."""
DERIVED = ("levels", "coarse")
"""Properties of a background that are derived from its mean; folders of earlier releases lack them."""
KEEP_EVERY_S = 600.0
"""Shortest time between two writes of the 110 MB; dust settles more slowly than that."""


def read_background(folder: Path) -> BackgroundModel:
    """Return the background model that `write_background` wrote; its arrays are views of the files."""
    # asarray: each view of a memmap is a Python object that costs as much as a kernel's call; copy on write, because
    # for read-only arrays kernels would be compiled once more
    arrays = {path.stem: np.asarray(np.load(path, mmap_mode="c")) for path in sorted(folder.glob("*.npy"))}
    model = {
        CameraId(name): CameraBackground(
            mean=mean,
            n_frames=n_frames,
            n_refused=n_refused,
            refused=arrays.get(name + REFUSED),
            clean=arrays.get(name + CLEAN),
        )
        for name, mean in arrays.items()
        if "." not in name
        for n_frames, n_refused in [arrays[name + COUNTS].tolist()]
    }
    for camera, known in model.items():
        for name in DERIVED:
            if (array := arrays.get(f"{camera}.{name}")) is not None:
                vars(known)[name] = array  # where a cached property keeps its value
    return model


def write_background(folder: Path, model: BackgroundModel) -> None:
    """Write the model, which may be that of some cameras, into a folder, which is created if missing."""
    folder.mkdir(parents=True, exist_ok=True)
    for camera, known in model.items():
        arrays: dict[str, NDArray[Any] | None] = {
            "": known.mean,
            COUNTS: np.array([known.n_frames, known.n_refused]),
            REFUSED: known.refused,
            CLEAN: known.clean,
            **{f".{name}": getattr(known, name) for name in DERIVED},
        }
        for ending, array in arrays.items():
            if array is not None:
                np.save(folder / f"{camera}{ending}.npy", array, allow_pickle=False)


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
        self._kept_at_s = -inf

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
        if time.monotonic() - self._kept_at_s < KEEP_EVERY_S:
            return
        self._kept_at_s = time.monotonic()
        try:
            with replacing(self._path) as unfinished, zipfile.ZipFile(unfinished, "w") as archive:
                # the format of numpy.savez, which earlier releases used; whole files: with zipfile's pieces of 8 kB the
                # interpreter's lock changes hands all the time
                for path in sorted(folder.iterdir()):
                    archive.writestr(path.name, path.read_bytes())
            for other in self._path.parent.glob("background-*.npz"):
                if other != self._path:
                    other.unlink()
        except OSError as err:
            log.error("the background is not kept for the next start: %s file=%s", err, self._path)
