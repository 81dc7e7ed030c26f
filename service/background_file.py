"""The background on disk: one file a version, never rewritten under its name."""

from pathlib import Path
from typing import Any

import numpy as np

from pipeline.frames import CameraId
from pipeline.segmentation import BackgroundModel
from pipeline.segmentation.background import CameraBackground

COUNTS, REFUSED, CLEAN = ".counts", ".refused", ".clean"
"""Endings of the arrays beside a camera's mean; a camera id has no dot."""


def read_background(path: Path) -> BackgroundModel:
    """The background model in a file written by `write_background`."""
    with path.open("rb") as file, np.load(file) as arrays:
        return {
            CameraId(name): CameraBackground(
                mean=arrays[name],
                n_frames=n_frames,
                n_refused=n_refused,
                refused=arrays.get(name + REFUSED),
                clean=arrays.get(name + CLEAN),
            )
            for name in arrays.files
            if "." not in name
            for n_frames, n_refused in [arrays[name + COUNTS].tolist()]
        }


def write_background(path: Path, model: BackgroundModel) -> None:
    """Write the model under a name that appears only when it is complete."""
    arrays: dict[str, Any] = {}
    for camera, known in model.items():
        arrays[camera] = known.mean
        arrays[camera + COUNTS] = np.array([known.n_frames, known.n_refused])
        if known.refused is not None:
            arrays[camera + REFUSED] = known.refused
        if known.clean is not None:
            arrays[camera + CLEAN] = known.clean
    partial = path.with_suffix(".tmp")
    with partial.open("wb") as file:
        np.savez(file, **arrays)
    partial.rename(path)
