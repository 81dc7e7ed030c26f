"""Reading the rig document, with every defect named by its member."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any, get_args

import numpy as np
import scipy.linalg

from pipeline.arrays import Floats, Matrix33, Vector
from pipeline.errors import RigError
from pipeline.formats import unread_format
from pipeline.frames import CAMERA_ID, CameraId
from pipeline.rig.cameras import FORMAT, CameraCalibration, Lens, Method, RigCalibration, checksum_of

FIELD_AT_ORIGIN_MM = (20.0, 250.0)
"""Plausible range of the image's width at the origin; outside it a focal length is in the wrong unit."""
MAX_MISS_MM = 10.0
"""Largest plausible distance between the origin and the ray through the centre of the image."""
OPENCV_COEFFICIENTS = (4, 8, 12, 14)
"""Numbers of coefficients that OpenCV gives beside five."""
LENS_RANGES = {
    "focal_length_mm": (1.0, 1000.0),
    "f_number": (0.5, 64.0),
    "focus_mm": (10.0, 1e5),
    "blur_px": (0.0, 50.0),
}
"""Plausible ranges of the members of a lens."""


def rig_from_document(document: Any) -> RigCalibration:
    """Return the rig that parsed JSON describes.

    Raises
    ------
    RigError
        Naming the first field that is damaged, contradicts another or is geometrically impossible.
    """
    root = _mapping(document, "document")
    if root.get("format") != FORMAT:
        raise RigError("format", unread_format(root.get("format"), FORMAT))
    try:
        expected = checksum_of(root)
    except UnicodeEncodeError as err:
        raise RigError("document", "holds text that is no Unicode") from err
    except ValueError as err:
        raise RigError("document", "numbers must be finite") from err
    if "checksum" in root and root["checksum"] != expected:
        raise RigError("checksum", "does not match the content: the file was damaged or edited")
    name = _member(root, "name", str, "")
    method = root.get("method", "imported")
    if method not in get_args(Method):
        raise RigError("method", f"must be one of {', '.join(get_args(Method))}, not {method!r}")
    ball_mm = _number(root, "ball_diameter_mm", (1e-6, 100), "", "a diameter in mm or null")
    entries = _member(root, "cameras", list, "")
    cameras = tuple(_camera(entry, f"cameras[{i}]") for i, entry in enumerate(entries))
    if len(cameras) < 2:
        raise RigError("cameras", f"a visual hull needs at least 2 cameras, not {len(cameras)}")
    for i, camera in enumerate(cameras):
        if camera.id in [other.id for other in cameras[:i]]:
            raise RigError(f"cameras[{i}].id", f"{camera.id!r} occurs twice")
    return RigCalibration(
        name=name,
        method=method,
        created_at=_created_at(root.get("created_at", "")),
        cameras=cameras,
        ball_diameter_mm=ball_mm,
        length_sd_percent=_number(
            root, "length_sd_percent", (0, 100), "", "a standard deviation in percent or null"
        ),
    )


def _created_at(value: Any) -> str:
    try:
        if value != "":
            datetime.fromisoformat(value)
    except (TypeError, ValueError) as err:
        raise RigError("created_at", f"must be a time as of RFC 3339, not {value!r}") from err
    return str(value)


def _camera(entry: Any, path: str) -> CameraCalibration:
    members = _mapping(entry, path)
    camera_id = _member(members, "id", str, path)
    if not CAMERA_ID.fullmatch(camera_id):
        raise RigError(f"{path}.id", f"must be letters, digits, '-' and '_', not {camera_id!r}")
    size = _numbers(members, "image_size_px", (2,), path)
    if not (np.all(size == np.round(size)) and np.all(size >= 16) and np.all(size <= 65535)):
        raise RigError(f"{path}.image_size_px", f"must be [W, H] in whole pixels, not {size.tolist()}")
    has_model = any(members.get(key) is not None for key in ("K", "R", "t_mm"))
    if not has_model and members.get("projection") is None:
        raise RigError(path, "needs K, R and t_mm, or projection")
    distortion = _distortion(members, path)
    if np.abs(distortion).max() > 10:
        raise RigError(f"{path}.distortion", f"implausible coefficients {distortion.tolist()}")
    if has_model:
        K = _numbers(members, "K", (3, 3), path)
        R = _rotation(_numbers(members, "R", (3, 3), path), path)
        t_mm = _numbers(members, "t_mm", (3,), path)
        if not (np.allclose(K[2], [0, 0, 1]) and K[1, 0] == 0):
            raise RigError(f"{path}.K", "must be upper triangular with last row [0, 0, 1]")
    else:
        K, R, t_mm = decompose_projection(_numbers(members, "projection", (3, 4), path), path)
    serial = members.get("serial")
    rms_px = _number(members, "rms_px", (0, 1e6), path, "a residual in pixels or null")
    if serial is not None and not isinstance(serial, str):
        raise RigError(f"{path}.serial", f"must be text or null, not {serial!r}")
    camera = CameraCalibration(
        id=CameraId(camera_id),
        image_size_px=(int(size[0]), int(size[1])),
        K=K,
        distortion=distortion,
        R=R,
        t_mm=t_mm,
        serial=serial,
        rms_px=rms_px,
        lens=None if members.get("lens") is None else _lens(members["lens"], f"{path}.lens"),
    )
    _require_plausible(camera, path)
    if has_model and members.get("projection") is not None:
        _require_agreement(camera, _numbers(members, "projection", (3, 4), path), path)
    return camera


def _distortion(members: Mapping[str, Any], path: str) -> Floats:
    """Return k1 k2 p1 p2 k3 (5,) of as many coefficients as OpenCV gives, of which the further ones must be 0."""
    values = members.get("distortion")
    if values is None:
        return np.zeros(5)
    n_given = len(values) if isinstance(values, list) and len(values) in OPENCV_COEFFICIENTS else 5
    given = _numbers(members, "distortion", (n_given,), path)
    if given[5:].any():
        raise RigError(
            f"{path}.distortion",
            f"has coefficients beyond k1 k2 p1 p2 k3, which no ray is bent by: {given[5:]}",
        )
    return np.append(given[:5], np.zeros(5))[:5]


def _lens(entry: Any, path: str) -> Lens:
    members = _mapping(entry, path)
    numbers = {}
    for name, (least, greatest) in LENS_RANGES.items():
        number = _number(members, name, (least, greatest), path, f"{least:g} to {greatest:g}")
        if number is None:
            raise RigError(f"{path}.{name}", "is missing")
        numbers[name] = number
    return Lens(**numbers)


def _require_plausible(camera: CameraCalibration, path: str) -> None:
    width_px, height_px = camera.image_size_px
    distance_mm = float(np.linalg.norm(camera.center_mm))
    if not 50 <= distance_mm <= 5000:
        raise RigError(f"{path}.t_mm", f"the camera is {distance_mm:.0f} mm from the origin")
    for focal_px in (camera.K[0, 0], camera.K[1, 1]):
        field_mm = width_px * distance_mm / focal_px if focal_px > 0 else np.inf
        if not FIELD_AT_ORIGIN_MM[0] <= field_mm <= FIELD_AT_ORIGIN_MM[1]:
            raise RigError(f"{path}.K", f"focal length {focal_px:.6g} px is out of range (is it in pixels?)")
    # in the middle no lens bends a ray by as much as is allowed here
    middle = np.linalg.solve(camera.K, [(width_px - 1) / 2, (height_px - 1) / 2, 1])
    direction = camera.R.T @ middle / np.linalg.norm(middle)
    along_mm = float(-camera.center_mm @ direction)
    miss_mm = float(np.linalg.norm(camera.center_mm + along_mm * direction))
    if along_mm <= 0 or miss_mm > MAX_MISS_MM:
        where = "looks away from the origin" if along_mm <= 0 else f"looks {miss_mm:.1f} mm past the origin"
        raise RigError(f"{path}.R", f"camera {camera.id} {where}")


def _require_agreement(camera: CameraCalibration, projection: Floats, path: str) -> None:
    axis_mm = np.array([-20.0, 0.0, 20.0])
    points_mm = np.stack(np.meshgrid(axis_mm, axis_mm, axis_mm), axis=-1).reshape(-1, 3)
    homogeneous = np.column_stack([points_mm, np.ones(len(points_mm))])
    own, other = homogeneous @ camera.projection.T, homogeneous @ projection.T
    with np.errstate(divide="ignore", invalid="ignore"):
        difference_px = np.abs(own[:, :2] / own[:, 2:] - other[:, :2] / other[:, 2:]).max()
    if not difference_px < 0.1:
        raise RigError(f"{path}.projection", f"contradicts K, R and t_mm by {difference_px:.3g} px")


def decompose_projection(projection: Floats, path: str) -> tuple[Matrix33, Matrix33, Vector]:
    """Return K, R and t in mm of a projection matrix (3, 4) of any scale and sign; `path` names it in the error.

    Raises
    ------
    RigError
        The matrix has no optical centre.
    """
    M = projection[:, :3]
    if not abs(np.linalg.det(M)) > 1e-12 * np.linalg.norm(M) ** 3:
        raise RigError(f"{path}.projection", "has no optical centre (its left 3x3 part is singular)")
    sign = np.sign(np.linalg.det(M))
    K, R = scipy.linalg.rq(sign * M)
    flip = np.diag(np.sign(np.diag(K)))
    K, R = K @ flip, flip @ R
    t_mm = np.linalg.solve(K, sign * projection[:, 3])
    return K / K[2, 2], R, t_mm


def _rotation(R: Matrix33, path: str) -> Matrix33:
    if not (np.abs(R @ R.T - np.eye(3)).max() < 1e-4 and np.linalg.det(R) > 0):
        raise RigError(f"{path}.R", "is not a rotation matrix")
    if np.abs(R @ R.T - np.eye(3)).max() < 1e-12:
        return R
    U, _, Vt = np.linalg.svd(R)  # a hand-made file has few digits
    return np.asarray(U @ Vt)


def _mapping(value: Any, path: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise RigError(path, f"must be an object, not {type(value).__name__}")
    return value


def _member(members: Mapping[str, Any], key: str, kind: type[Any], path: str) -> Any:
    value = members.get(key)
    if not isinstance(value, kind):
        where = f"{path}.{key}" if path else key
        raise RigError(where, "is missing" if value is None else f"must be a {kind.__name__}, not {value!r}")
    return value


def _number(
    members: Mapping[str, Any], key: str, limits: tuple[float, float], path: str, wanted: str
) -> float | None:
    """Return an optional number within limits; `wanted` says in the error what it must be."""
    value = members.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not limits[0] <= value <= limits[1]:
        raise RigError(f"{path}.{key}" if path else key, f"must be {wanted}, not {value!r}")
    return float(value)


def _numbers(members: Mapping[str, Any], key: str, shape: tuple[int, ...], path: str) -> Floats:
    where = f"{path}.{key}"
    if members.get(key) is None:
        raise RigError(where, "is missing")
    try:
        array = np.array(members[key], dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as err:
        raise RigError(where, "must hold numbers") from err
    if array.shape != shape:
        raise RigError(where, f"must have shape {list(shape)}, not {list(array.shape)}")
    if not np.isfinite(array).all():
        raise RigError(where, "must hold finite numbers")
    return array
