"""Cameras of other programs as entries of the rig document: bare matrices, OpenCV, COLMAP, Blender and its relatives.

All that differs is put right here: the place of pixel (0, 0), whose centre has the coordinates (0.5, 0.5) in COLMAP
and in files of Blender's form; the axes, of which Blender's y is up and z backwards; camera to world, or world to
camera. Unit and origin, which a file does not tell, are those of `pipeline.rig.placing`.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from pipeline.arrays import Floats, Vector
from pipeline.errors import RigError
from pipeline.rig.placing import Entry

Size = tuple[int, int]
CORNER_PX = 0.5
"""Coordinate of the centre of the first pixel where pixels are counted from the corner of the image."""
COLMAP_MODELS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
}
"""Models of COLMAP that are OpenCV's, and their parameters; others bend rays in another way."""
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""Coefficients of distortion in the order of OpenCV."""
LARGEST = 1e9
"""Greatest number of a lens or an image, in px or without unit."""
FLIP = np.diag([1.0, -1.0, -1.0])
"""From a camera with y up, looking along -z, to one with y down, looking along z."""


def from_matrices(text: str, size_px: Size) -> list[Entry]:
    """Return the cameras of a text with a line for each: its name, then P (3, 4), or K (3, 3), R (3, 3) and t (3,).

    Numbers are row by row, and commas and brackets between them count as blanks. A line that begins with # is a
    comment, and one number alone the count of cameras, as in the multi-view data sets of Middlebury.

    Raises
    ------
    RigError
        A line has another form.
    """
    entries = []
    for number, words in _lines(re.sub(r"[\[\](),;]", " ", text)):
        if len(words) == 1 and words[0].isdigit():
            continue
        values = _floats(words[1:], f"line {number}")
        entry: Entry = {"id": camera_name(words[0]), "image_size_px": list(size_px)}
        if len(values) == 12:
            entry["projection"] = values.reshape(3, 4)
        elif len(values) == 21:
            entry |= {"K": values[:9].reshape(3, 3), "R": values[9:18].reshape(3, 3), "t_mm": values[18:]}
        else:
            raise RigError(
                f"line {number}",
                f"must have a name and 12 numbers (P) or 21 (K, R, t), not {len(values)} of them",
            )
        entries.append(entry)
    return entries


def from_opencv(name: str, matrices: Mapping[str, Floats], size_px: Size) -> Entry:
    """Return the camera that OpenCV's names describe: K, R or a rotation vector, t, and coefficients of distortion.

    Raises
    ------
    RigError
        One of the first three is missing, or has another shape.
    """
    rotation = _sized(matrices, "R", (9, 3), name)
    return {
        "id": name,
        "image_size_px": list(size_px),
        "K": _sized(matrices, "K", (9,), name).reshape(3, 3),
        "distortion": matrices["distortion"].ravel().tolist() if "distortion" in matrices else None,
        "R": rotation.reshape(3, 3) if rotation.size == 9 else Rotation.from_rotvec(rotation).as_matrix(),
        "t_mm": _sized(matrices, "t", (3,), name),
    }


def from_colmap(cameras: str, images: str) -> list[Entry]:
    """Return a camera for each image of a model of COLMAP, by its cameras.txt and images.txt.

    Raises
    ------
    RigError
        A line is not what COLMAP writes, or a camera is of a model that is not OpenCV's.
    """
    lenses = {}
    for number, words in _lines(cameras):
        if len(words) < 5 or words[1] not in COLMAP_MODELS:
            raise RigError(
                f"cameras.txt: line {number}",
                f"must be of one of the models {', '.join(COLMAP_MODELS)}, not {' '.join(words[1:2])!r}",
            )
        names, values = COLMAP_MODELS[words[1]].split(), _floats(words[2:], f"cameras.txt: line {number}")
        if len(values) != 2 + len(names):
            raise RigError(f"cameras.txt: line {number}", f"{words[1]} has {len(names)} parameters")
        width_px, height_px, *rest = values.tolist()
        lenses[words[0]] = _lens(dict(zip(names, rest, strict=True)), (int(width_px), int(height_px)))
    entries = []
    for number, words in _lines(images):
        if len(words) < 10 or (len(words) % 3 == 0 and _is_number(words[-1])):
            continue  # the points that the image before sees
        where = f"images.txt: line {number}"
        pose = _floats(words[1:8], where)
        if words[8] not in lenses:
            raise RigError(where, f"camera {words[8]} is not in cameras.txt")
        if not pose[:4].any():
            raise RigError(where, "has no rotation")
        R = Rotation.from_quat([*pose[1:4], pose[0]]).as_matrix()
        entries.append({**lenses[words[8]], "id": camera_name(" ".join(words[9:])), "R": R, "t_mm": pose[4:]})
    return entries


def from_blender(document: Mapping[str, Any], size_px: Size) -> list[Entry]:
    """Return the cameras of a transforms.json, as add-ons of Blender, instant-ngp and nerfstudio write it.

    What stands beside `frames` is true of each frame that does not say otherwise. Without a principal point it is
    the centre of the image; without `w` and `h` the images have `size_px`.

    Raises
    ------
    RigError
        A frame has no pose or no focal length, or the lens is a fisheye.
    """
    entries = []
    for index, frame in enumerate(document["frames"]):
        where = f"frames[{index}]"
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise RigError(where, "must have a file_path")
        own = {**document, **frame}
        if "FISHEYE" in str(own.get("camera_model", "")).upper() or own.get("is_fisheye"):
            raise RigError(f"{where}.camera_model", "is a fisheye, which no rig has")
        pose = _floats(own.get("transform_matrix"), f"{where}.transform_matrix")
        if pose.shape not in ((3, 4), (4, 4)):
            raise RigError(f"{where}.transform_matrix", "must be (4, 4) or (3, 4)")
        width_px, height_px = (
            int(_number(own, key, where) or size) for key, size in zip("wh", size_px, strict=True)
        )
        focal_px = _number(own, "fl_x", where)
        if focal_px is None and (angle := _number(own, "camera_angle_x", where)):
            focal_px = width_px / 2 / np.tan(angle / 2)
        if focal_px is None:
            raise RigError(f"{where}.fl_x", "is missing, and so is camera_angle_x")
        lens = {"fx": focal_px, "fy": _number(own, "fl_y", where) or focal_px}
        for key, middle in (("cx", width_px / 2), ("cy", height_px / 2)):
            given = _number(own, key, where)
            lens[key] = middle if given is None else given
        lens |= {key: _number(own, key, where) or 0.0 for key in COEFFICIENTS}
        R = FLIP @ pose[:3, :3].T
        entries.append(
            {
                **_lens(lens, (width_px, height_px)),
                "id": camera_name(frame["file_path"]),
                "R": R,
                "t_mm": -R @ pose[:3, 3],
            }
        )
    return entries


def camera_name(path: str) -> str:
    """Return the id of the camera of an image: the name of its file, by either kind of slash, without the suffix."""
    return re.sub(r"\.[A-Za-z]\w*$", "", re.split(r"[/\\]", path)[-1])


def _lens(values: Mapping[str, float], size_px: Size) -> Entry:
    """Return the entry of a lens whose pixels are counted from the corner of the image."""
    fx, fy = values.get("fx", values.get("f")), values.get("fy", values.get("f"))
    cx, cy = values["cx"] - CORNER_PX, values["cy"] - CORNER_PX
    return {
        "image_size_px": list(size_px),
        "K": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]],
        "distortion": [values.get(key, 0.0) for key in COEFFICIENTS],
    }


def _lines(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield number and words of each line that is no comment."""
    for number, line in enumerate(text.splitlines(), 1):
        if not line.lstrip().startswith("#") and (words := line.split()):
            yield number, words


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _floats(values: ArrayLike | None, where: str) -> Vector:
    if values is None:
        raise RigError(where, "is missing")
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as err:
        raise RigError(where, "must hold numbers") from err
    if not np.isfinite(array).all():
        raise RigError(where, "must hold finite numbers")
    return array


def _number(members: Mapping[str, Any], key: str, where: str) -> float | None:
    value = members.get(key)
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
        raise RigError(f"{where}.{key}", f"must be a number, not {value!r}")
    if value is not None and not abs(value) <= LARGEST:
        raise RigError(f"{where}.{key}", f"must be a number up to {LARGEST:g}")
    return value


def _sized(matrices: Mapping[str, Floats], key: str, sizes: Sequence[int], name: str) -> Vector:
    if key not in matrices:
        raise RigError(f"{name}.{key}", "is missing")
    values = matrices[key].ravel()
    if values.size not in sizes:
        raise RigError(
            f"{name}.{key}", f"must have {' or '.join(map(str, sizes))} numbers, not {values.size}"
        )
    return values
