"""The background on disk: one file a version, never rewritten under its name.

It is an archive of arrays as numpy writes them, each at an address that lets it be mapped: the means of 16 cameras
are 84 MB, which all workers share.
"""

import mmap
import struct
import zipfile
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import CameraId
from pipeline.segmentation import BackgroundModel
from pipeline.segmentation.background import CameraBackground

COUNTS, REFUSED, CLEAN = ".counts", ".refused", ".clean"
"""Endings of the arrays beside a camera's mean; a camera id has no dot."""
LOCAL_HEADER, ZIP64_FIELD, FIELD_HEADER = 30, 20, 4
"""Bytes before a member of an archive, but for its name: as zipfile writes them."""
ALIGNMENT_FIELD = 0xD935
"""What Android's zipalign calls the field that moves a member to its address."""
ALIGNMENT = 64
"""Of the arrays in memory; numpy's header is a multiple of it."""


def read_background(path: Path, *, mapped: bool = False) -> BackgroundModel:
    """The background model in a file written by `write_background`.

    `mapped`: the means are views of the file, unchecked, without a copy.
    """
    with path.open("rb") as file, np.load(file) as arrays:
        mapping = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if mapped else None
        return {
            CameraId(name): CameraBackground(
                mean=arrays[name] if mapping is None else _view(mapping, arrays.zip.getinfo(f"{name}.npy")),
                n_frames=n_frames,
                n_refused=n_refused,
                refused=arrays.get(name + REFUSED),
                clean=arrays.get(name + CLEAN),
            )
            for name in arrays.files
            if "." not in name
            for n_frames, n_refused in [arrays[name + COUNTS].tolist()]
        }


def _view(mapping: mmap.mmap, member: zipfile.ZipInfo) -> NDArray[np.float32]:
    """The array of a member where it lies in its archive; a copy from one that did not care about addresses."""
    n_name, n_extra = struct.unpack_from("<HH", mapping, member.header_offset + LOCAL_HEADER - 4)
    mapping.seek(member.header_offset + LOCAL_HEADER + n_name + n_extra)
    np.lib.format.read_magic(mapping)
    shape, _, dtype = np.lib.format.read_array_header_1_0(mapping)
    array = np.frombuffer(mapping, dtype, prod(shape), mapping.tell()).reshape(shape)
    return np.require(array, requirements="A")


def write_background(path: Path, model: BackgroundModel) -> None:
    """Write the model under a name that appears only when it is complete."""
    arrays: dict[str, NDArray[Any]] = {}
    for camera, known in model.items():
        arrays[camera] = known.mean
        arrays[camera + COUNTS] = np.array([known.n_frames, known.n_refused])
        if known.refused is not None:
            arrays[camera + REFUSED] = known.refused
        if known.clean is not None:
            arrays[camera + CLEAN] = known.clean
    partial = path.with_suffix(".tmp")
    with partial.open("wb") as file, zipfile.ZipFile(file, "w") as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy")
            begin = file.tell() + LOCAL_HEADER + len(member.filename) + FIELD_HEADER + ZIP64_FIELD
            padding = -begin % ALIGNMENT
            member.extra = struct.pack("<HH", ALIGNMENT_FIELD, padding) + bytes(padding)
            with archive.open(member, "w", force_zip64=True) as content:
                np.lib.format.write_array(content, array, allow_pickle=False)
    partial.rename(path)
