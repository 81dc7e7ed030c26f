"""Bodies in the views of a rig as what differs from the empty rig, without an image."""

from collections.abc import Sequence

import cv2
import numpy as np

from pipeline.arrays import PointsMM
from pipeline.geometry.icosphere import icosphere
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.segmentation.background import COARSE
from pipeline.segmentation.view_parts import parts_of
from pipeline.views.near_stones import CameraParts

MIN_PX = 300.0


def ball_points(center_mm: Sequence[float], diameter_mm: float) -> PointsMM:
    """Points on a sphere."""
    return np.asarray(center_mm) + diameter_mm / 2 * icosphere(3)[0]


def parts_in(camera: CameraCalibration, bodies: Sequence[PointsMM]) -> CameraParts:
    """What a camera sees of the convex hulls of points."""
    width_px, height_px = camera.image_size_px
    marks = np.zeros((height_px // COARSE, width_px // COARSE), np.uint8)
    for points_mm in bodies:
        blocks = (camera.project(points_mm)[0] - (COARSE - 1) / 2) / COARSE
        outline = cv2.convexHull(blocks.astype(np.float32))
        cv2.fillConvexPoly(marks, np.rint(outline).astype(np.int32), 1)
    differs = marks != 0
    return CameraParts(camera=camera, parts=parts_of(differs, np.zeros_like(differs), MIN_PX))


def views_of(rig: RigCalibration, bodies: Sequence[PointsMM]) -> list[CameraParts]:
    """What each camera sees of the convex hulls of points."""
    return [parts_in(camera, bodies) for camera in rig.cameras]
