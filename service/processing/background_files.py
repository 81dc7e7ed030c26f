"""Read and write background models: one folder a version, never rewritten under its name.

Every array is a file in numpy's format, `<camera>.npy` the mean and others beside it. They are mapped: the means
of 16 cameras are 84 MB, which all workers share. What segmentation derives from whole means is stored as well:
otherwise each worker would compute it anew after each exposure of the empty rig, while a stone waits.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import CameraId
from pipeline.segmentation import BackgroundModel
from pipeline.segmentation.background import CameraBackground

COUNTS, REFUSED, CLEAN = ".counts", ".refused", ".clean"
"""Endings of the names of arrays beside a camera's mean; a camera id has no dot."""
DERIVED = ("levels", "coarse")
"""Properties of a background that are derived from its mean; folders of earlier releases lack them."""


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
