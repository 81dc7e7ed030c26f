"""The background on disk: a folder a version, never rewritten under its name.

Every array is a file as numpy writes them, `<camera>.npy` the mean and others beside it. They are mapped: the means
of 16 cameras are 84 MB, which all workers share. What segmentation asks of a mean with all its pixels is there as well:
each worker would compute it anew after each exposure of the empty rig, while a stone waits.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import CameraId
from pipeline.segmentation import BackgroundModel
from pipeline.segmentation.background import CameraBackground

COUNTS, REFUSED, CLEAN = ".counts", ".refused", ".clean"
"""Endings of the arrays beside a camera's mean; a camera id has no dot."""
FOLLOWING = ("levels", "coarse")
"""Properties of a background that follow from its mean. Folders of before lack them."""


def read_background(folder: Path) -> BackgroundModel:
    """The background model that `write_background` wrote; its arrays are views of the files."""
    # not memmap: each view of one is a Python object that costs as much as a kernel's call; and to be written to, in
    # this process alone: for what may not be, kernels would be compiled once more
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
        for name in FOLLOWING:
            if (array := arrays.get(f"{camera}.{name}")) is not None:
                vars(known)[name] = array  # where a cached property has its value
    return model


def write_background(folder: Path, model: BackgroundModel) -> None:
    """Write the model, or what it knows of some cameras, into a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    for camera, known in model.items():
        arrays: dict[str, NDArray[Any] | None] = {
            "": known.mean,
            COUNTS: np.array([known.n_frames, known.n_refused]),
            REFUSED: known.refused,
            CLEAN: known.clean,
            **{f".{name}": getattr(known, name) for name in FOLLOWING},
        }
        for ending, array in arrays.items():
            if array is not None:
                np.save(folder / f"{camera}{ending}.npy", array, allow_pickle=False)
