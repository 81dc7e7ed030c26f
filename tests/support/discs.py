"""Spheres in the views of a rig as what differs from the empty rig, without an image."""

from collections.abc import Sequence

import cv2
import numpy as np

from pipeline.arrays import Vector
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation.background import COARSE
from pipeline.segmentation.view_parts import parts_of
from pipeline.views.near_stones import CameraParts

MIN_PX = 300.0


def views_of(rig: RigCalibration, spheres: Sequence[tuple[Vector, float]]) -> list[CameraParts]:
    """What each camera sees of spheres, given by centre and diameter in mm."""
    views = []
    for camera in rig.cameras:
        width_px, height_px = camera.image_size_px
        marks = np.zeros((height_px // COARSE, width_px // COARSE), np.uint8)
        for center_mm, diameter_mm in spheres:
            (at,), (depth_mm,) = camera.project(center_mm[None])
            radius_px = diameter_mm / 2 * camera.focal_px / float(depth_mm)
            middle = np.rint((at - (COARSE - 1) / 2) / COARSE).astype(int)
            cv2.circle(marks, (int(middle[0]), int(middle[1])), round(radius_px / COARSE), 1, cv2.FILLED)
        differs = marks != 0
        views.append(CameraParts(camera=camera, parts=parts_of(differs, np.zeros_like(differs), MIN_PX)))
    return views
