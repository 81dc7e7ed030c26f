"""Background models: read, write and keep them, and choose the version that each stone is measured with.

One folder a version, never rewritten under its name. Every array is a file in numpy's format, `<camera>.npy` the mean
and others beside it. They are mapped: the means of 16 cameras are 84 MB, which all workers share. What segmentation
derives from whole means is stored as well: otherwise each worker would compute it anew after each exposure of the
empty rig, while a stone waits.

The newest background is kept for the next start of the daemon: a running crusher may never show the rig empty.
For live rigs only, under a hash of the cameras and their settings; after a change of these nothing is restored.
A new calibration changes nothing about the images. In replay nothing is kept, or results would depend on what
ran before.

Which version a stone is measured with depends on the order of the bundles alone. The first exposures of the empty rig
are learnt before any later bundle is started. After these, one more makes little difference, and stones do not wait for
it: it is learnt while the next ones are measured, and used from a fixed number of stones later on, or when another
exposure follows.
"""

import asyncio
import hashlib
import json
import logging
import shutil
import time
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.files.durable import replacing
from pipeline.frames import CameraId
from pipeline.segmentation import BackgroundModel
from pipeline.segmentation.background import CameraBackground
from pipeline.segmentation.noise import TYPICAL_NOISE, SensorNoise
from service.processing.left_bundles import BACKGROUND

log = logging.getLogger(__name__)

COUNTS, REFUSED, CLEAN, NOISE = ".counts", ".refused", ".clean", ".noise"
"""Endings of the names of arrays beside a camera's mean; a camera id has no dot."""
DERIVED = ("levels", "coarse")
"""Properties of a background that are derived from its mean; folders of earlier releases lack them."""
KEEP_EVERY_S = 600.0
"""Shortest time between two writes of the 110 MB; dust settles more slowly than that."""
N_AWAITED = 3
"""Exposures that stones wait for: the mean of three has hardly more noise than that of more."""
N_BESIDE = 8
"""Stones that are started while an exposure is learnt, which takes as long as three of them."""
LEARNING = "learning-"
"""Begins the name of a version's folder until it is complete."""


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
            noise=SensorNoise(*arrays[name + NOISE].tolist()) if name + NOISE in arrays else TYPICAL_NOISE,
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
            NOISE: np.array(known.noise),
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
            log.error("the kept background cannot be restored and is not used: %s file=%s", err, self._path)
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


@dataclass(frozen=True, slots=True)
class LearntBackground:
    """A new version, in a folder, and the optics of each camera in its exposure (`results.record.optics_record`)."""

    path: Path
    optics: dict[str, Any]


class BackgroundVersions:
    """The version `in_use`, and the exposure that is being learnt, which becomes the next version."""

    def __init__(self, folder: Path, kept: KeptBackground | None) -> None:
        """`folder`: of all versions; `kept`: the background of the last session, for the next one, if any is kept."""
        self.in_use: Path | None = None
        self._folder = folder
        self._kept = kept
        self._keeping: asyncio.Task[None] | None = None
        self._n_folders = 0
        self._n_learnt = 0
        self._next: asyncio.Task[Any] | None = None
        self._n_beside = 0
        self._retired: list[Path] = []

    async def restore(self) -> None:
        """Begin with the background that was kept for this start, without one if there is none."""
        self.in_use, self._next, self._n_learnt = None, None, 0
        learning = self.new_folder()
        if self._kept is not None and await asyncio.to_thread(self._kept.restore, learning) is not None:
            self.in_use = complete(learning)

    async def restore_if_gone(self) -> None:
        """Begin anew when the folder of the version in use was deleted."""
        if self.in_use is not None and not self.in_use.exists():
            log.error("the background was deleted from the spool folder=%s", self._folder)
            await self.restore()

    def new_folder(self) -> Path:
        """Return where the next version is to be written, until `complete` gives it its name."""
        self._n_folders += 1
        return self._folder / f"{LEARNING}{self._n_folders:08d}"

    async def advance(self, is_background: bool) -> tuple[Path, ...]:
        """Wait until `in_use` is the version that the next bundle needs; return those no longer needed from it on."""
        self._n_beside += not is_background
        if is_background or self._n_beside > N_BESIDE:
            await self._use_next()
        retired, self._retired = tuple(self._retired), []
        return retired

    async def learn(self, job: asyncio.Task[Any]) -> None:
        """Note the job that learns an exposure, and wait for it if later bundles have to.

        A result that is not a `LearntBackground` changes nothing.
        """
        self._next, self._n_beside = job, 0
        if self._n_learnt < N_AWAITED:
            await self._use_next()

    async def _use_next(self) -> None:
        job, self._next = self._next, None
        if job is None:
            return
        await asyncio.wait([job])
        if not job.cancelled() and job.exception() is None and isinstance(job.result(), LearntBackground):
            if self.in_use is not None:
                self._retired.append(self.in_use)
            self.in_use = job.result().path
            self._n_learnt += 1

    async def keep(self, path: Path, tasks: asyncio.TaskGroup) -> None:
        """Keep a version for the next start, in a task: stones do not wait for the disk."""
        if self._keeping is not None:
            await self._keeping
        if self._kept is not None:
            self._keeping = tasks.create_task(asyncio.to_thread(self._kept.keep, path))

    async def remove(self, versions: Sequence[Path]) -> None:
        """Remove versions when none is being copied for the next start."""
        if self._keeping is not None:
            await asyncio.wait([self._keeping])
        for path in versions:
            await asyncio.to_thread(shutil.rmtree, path, ignore_errors=True)


def complete(learning: Path) -> Path:
    """Give a version of the background the name that says that it is complete."""
    return learning.rename(learning.with_name(learning.name.replace(LEARNING, BACKGROUND)))
