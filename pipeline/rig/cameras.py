"""The calibrated cameras: projection, rays, and the rig as a document (read by `pipeline.rig.document`).

World frame: origin at the rig's centre, right-handed, z up, mm. Camera frame as in OpenCV:
`x_cam = R @ x_world + t`. Pixels (u, v) = (column, row), centres on integers.
Projection follows eqs. (1)-(3) of the paper, `w x = K [R|t] X`, preceded by the radial and
tangential distortion (k1, k2, p1, p2, k3) of OpenCV.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import Directions, Floats, Matrix33, PointsUV, Values, Vector
from pipeline.frames import CameraId
from pipeline.rig.lens import distort, normalized_coordinates

FORMAT = "stonefall-rig/1"
Method = Literal["nominal", "paper", "bundle", "imported"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """Lens parameters that blur a point out of focus, see `pipeline.rig.depth_blur`.

    Images show the aperture's diameter alone: the nominal focal length only turns it into the number on the barrel.
    """

    focal_length_mm: float
    f_number: float
    focus_mm: float  # depth of the plane in focus, along the optical axis
    blur_px: float  # sigma of an edge in focus: lens, pixels and the motion of a falling body

    @property
    def aperture_mm(self) -> float:
        """Diameter of the aperture."""
        return self.focal_length_mm / self.f_number


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraCalibration:
    """A pinhole camera with lens distortion; its arrays are read-only."""

    id: CameraId
    image_size_px: tuple[int, int]  # W, H
    K: Matrix33  # px
    distortion: Floats  # (5,) k1 k2 p1 p2 k3
    R: Matrix33
    t_mm: Vector
    serial: str | None = None
    rms_px: float | None = None
    lens: Lens | None = None  # `None`: how it blurs is not known

    def __post_init__(self) -> None:
        for array in (self.K, self.distortion, self.R, self.t_mm):
            array.setflags(write=False)

    @property
    def projection(self) -> Floats:
        """Projection matrix K [R|t] (3, 4), without distortion."""
        return self.K @ np.column_stack([self.R, self.t_mm])

    @property
    def center_mm(self) -> Vector:
        """Optical centre in the world frame."""
        return -self.R.T @ self.t_mm

    @property
    def focal_px(self) -> float:
        """Mean focal length."""
        return float((self.K[0, 0] + self.K[1, 1]) / 2)

    def project(self, points_world_mm: ArrayLike) -> tuple[PointsUV, Values]:
        """Project world points (N, 3) to pixels (N, 2); also return their depths (N,) in mm along the optical axis."""
        points_camera_mm = np.asarray(points_world_mm, dtype=np.float64) @ self.R.T + self.t_mm
        depths_mm = points_camera_mm[:, 2]
        normalized = points_camera_mm[:, :2] / depths_mm[:, None]
        distorted = distort(normalized, self.distortion)
        return distorted @ self.K[:2, :2].T + self.K[:2, 2], depths_mm

    def normalized_coordinates(self, pixels_uv: ArrayLike) -> PointsUV:
        """Return the undistorted image coordinates (x/z, y/z) (N, 2) of pixels (N, 2)."""
        pixels = np.asarray(pixels_uv, dtype=np.float64).reshape(-1, 2)
        owners = np.zeros(len(pixels), np.int64)
        return normalized_coordinates(pixels, owners, np.array([self.K]), np.array([self.distortion]))

    def rays(self, pixels_uv: ArrayLike) -> Directions:
        """Return unit directions (N, 3) in the world frame of the viewing rays through pixels (N, 2)."""
        normalized = self.normalized_coordinates(pixels_uv)
        rays = np.column_stack([normalized, np.ones(len(normalized))])
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True) @ self.R)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigCalibration:
    """The calibrated cameras of a rig, in the order of the pages of its bundles."""

    name: str
    method: Method
    created_at: str
    cameras: tuple[CameraCalibration, ...]
    ball_diameter_mm: float | None = None
    length_sd_percent: float | None = None  # standard deviation of lengths, by its calibration

    @property
    def camera_ids(self) -> tuple[CameraId, ...]:
        """Ids of the cameras."""
        return tuple(camera.id for camera in self.cameras)

    @property
    def calibration_id(self) -> str:
        """Checksum of the rig's document: equal rigs have equal ids, every result carries it."""
        return str(rig_to_document(self)["checksum"])

    def subset(self, camera_ids: Iterable[CameraId]) -> "RigCalibration":
        """Return the same rig with only these cameras, in its order."""
        wanted = set(camera_ids)
        return replace(self, cameras=tuple(camera for camera in self.cameras if camera.id in wanted))


# --- the rig document (format "stonefall-rig/1") ---


def rig_to_document(rig: RigCalibration) -> dict[str, Any]:
    """Return the rig as JSON-ready values, with its checksum."""
    document: dict[str, Any] = {
        "format": FORMAT,
        "name": rig.name,
        "created_at": rig.created_at,
        "method": rig.method,
        "ball_diameter_mm": rig.ball_diameter_mm,
        "cameras": [_camera_document(camera) for camera in rig.cameras],
    }
    if rig.length_sd_percent is not None:  # a file without it keeps its checksum
        document["length_sd_percent"] = rig.length_sd_percent
    document["checksum"] = checksum_of(document)
    return document


def _camera_document(camera: CameraCalibration) -> dict[str, Any]:
    document = {
        "id": camera.id,
        "serial": camera.serial,
        "image_size_px": list(camera.image_size_px),
        "K": camera.K.tolist(),
        "distortion": camera.distortion.tolist(),
        "R": camera.R.tolist(),
        "t_mm": camera.t_mm.tolist(),
        "projection": camera.projection.tolist(),
        "rms_px": camera.rms_px,
    }
    return document if camera.lens is None else {**document, "lens": asdict(camera.lens)}


def checksum_of(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 (hex) of the canonical JSON (sorted keys, no spaces, UTF-8) without the member `checksum`."""
    bare = {key: value for key, value in document.items() if key != "checksum"}
    canonical = json.dumps(bare, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()
