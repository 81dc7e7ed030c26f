"""Whether the views show one rigid body, and which view does not.

Two tests. Epipolar tangency (`pipeline.calibration.tangency`) compares views in pairs: it sees a tenth of a
pixel, names the one view that is wrong whatever its error does to the hull, and needs no hull. What it cannot
see, such as a bay that one view fills, the hull shows:

Every point of a silhouette's edge is the image of a point of the body: the viewing ray through it
must touch the body, hence the hull of the other views. For a ray of view k the largest value along
it of the other views' field is its signed clearance: about zero or a little above for a consistent view
(the hull is never smaller than the body), negative where view k claims a body that others exclude,
and large where it denies a body that all others see.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration.tangency import (
    EpipolarTangents,
    epipolar_tangents,
    image_shifts_px,
    outlines_of,
    tangency_scores_px,
)
from pipeline.carving import View, distances_mm, smallest, usable_views
from pipeline.frames import CameraId
from pipeline.rig import RigCalibration
from pipeline.segmentation.silhouette import MARGIN_PX, Silhouette

RAYS = 64
"""Rays a view, spread evenly over its outline."""
STEPS = (40, 9, 9)
"""Samples a ray within the sphere around the body, then around the highest of the last ones."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ConsistencyParameters:
    """When a view contradicts the others."""

    max_suspect_views: int = 2  # views that may be dropped for that; more mean a bundle to reject
    max_residual_px: float = 4.0  # rms by which an outline may leave the hull of the others
    max_denied_share: float = 0.1  # of the body's diameter: median clearance of a view that sees too little
    max_tangency_px: float = 1.5  # median epipolar residual of a view; below it, losing the view costs more
    max_tangency_ratio: float = 5.0  # of that residual to the median of the other views'

    def __post_init__(self) -> None:
        if self.max_suspect_views < 0:
            raise ValueError("max_suspect_views must not be negative")
        if not (self.max_residual_px > 0 and self.max_denied_share > 0):
            raise ValueError("max_residual_px and max_denied_share must be positive")
        if not (self.max_tangency_px > 0 and self.max_tangency_ratio > 1):
            raise ValueError("max_tangency_px must be positive and max_tangency_ratio above 1")


@dataclass(frozen=True, slots=True, kw_only=True)
class Consistency:
    """What the views say of each other."""

    residuals_px: Mapping[CameraId, float]  # rms by which a view's outline leaves the hull of the others
    suspects: Mapping[CameraId, str]  # views to drop, worst first, with what is wrong with them
    is_consistent: bool  # what is left after dropping them agrees
    tangency_px: Mapping[CameraId, float]  # median epipolar residual of a view, dropped ones included
    image_shifts_px: Mapping[CameraId, tuple[float, float]]  # of a view against where the others expect it


def check_consistency(
    silhouettes: Mapping[CameraId, Silhouette], rig: RigCalibration, parameters: ConsistencyParameters
) -> Consistency:
    """Residuals of every usable view, and the views that contradict the rest.

    Views that tangency names are dropped first. Of the rest, the worst is dropped and the others judged again,
    until all agree or `max_suspect_views` are exceeded. While r more views may be dropped, r votes against a
    point are not counted, so that a bad view does not condemn the good ones. Where all tangents agree, all votes
    are counted first: if nothing contradicts even then, that was all.
    """
    views = usable_views(silhouettes, rig)
    tangents = epipolar_tangents(outlines_of(silhouettes), rig)
    tangency_px, shifts_px = tangency_scores_px(tangents), image_shifts_px(tangents)
    suspects, is_consistent = displaced_views(tangents, parameters)
    views = [view for view in views if view[0].id not in suspects]
    agree = all(tangency_px.get(camera.id, np.inf) <= parameters.max_tangency_px for camera, _ in views)
    while True:
        may_be_dropped = max(min(parameters.max_suspect_views - len(suspects), len(views) - 3), 0)
        overruled = 0 if agree else may_be_dropped
        sphere = _body_sphere(views, overruled)
        if sphere is None and agree:
            agree = False
            continue
        if sphere is None:
            return Consistency(
                residuals_px={},
                suspects=suspects,
                is_consistent=False,
                tangency_px=tangency_px,
                image_shifts_px=shifts_px,
            )
        clearances = _clearances_px(views, sphere, overruled)
        worst, score = None, 1.0
        for (camera, _), clearance in zip(views, clearances, strict=True):
            # the smallest diameter of a body in a sphere around its box is some 1 / sqrt(3) of the sphere's
            diameter_px = 1.2 * sphere[1] * camera.focal_px / float(np.linalg.norm(camera.center_mm))
            # clearances are cut off like the distances they come from
            denied_px = min(parameters.max_denied_share * diameter_px, 0.7 * MARGIN_PX)
            claimed = _rms_outside(clearance) / parameters.max_residual_px
            denied = float(np.median(clearance)) / denied_px if len(clearance) else 0.0
            if tangency_px.get(camera.id, np.inf) <= parameters.max_tangency_px:
                denied = 0.0  # it only knows what no other view does: the hull without it is that much larger
            if max(claimed, denied) > score:
                worst, score = camera.id, max(claimed, denied)
                problem = "claims a body that other views exclude" if claimed > denied else "denies the body"
        if worst is not None and agree:
            agree = False
            continue
        if worst is None or len(suspects) == parameters.max_suspect_views:
            break
        suspects[worst] = f"contradicts the other views: {problem}"
        views = [view for view in views if view[0].id != worst]
    if overruled:
        clearances = _clearances_px(views, sphere, 0)
    residuals_px = {
        camera.id: _rms_outside(clearance) for (camera, _), clearance in zip(views, clearances, strict=True)
    }
    return Consistency(
        residuals_px=residuals_px,
        suspects=suspects,
        is_consistent=is_consistent and worst is None,
        tangency_px=tangency_px,
        image_shifts_px=shifts_px,
    )


def displaced_views(
    tangents: EpipolarTangents, parameters: ConsistencyParameters
) -> tuple[dict[CameraId, str], bool]:
    """Views whose tangents alone are far off, worst first, and whether these are all of them."""
    suspects: dict[CameraId, str] = {}
    while scores_px := tangency_scores_px(tangents, without=suspects):
        worst = max(scores_px, key=lambda camera: scores_px[camera])
        score_px = scores_px.pop(worst)
        if not scores_px or score_px <= max(
            parameters.max_tangency_px,
            parameters.max_tangency_ratio * float(np.median(list(scores_px.values()))),
        ):
            break
        if len(suspects) == parameters.max_suspect_views:
            return suspects, False
        suspects[worst] = f"contradicts the other views: its tangents miss theirs by {score_px:.1f} px"
    return suspects, True


def _rms_outside(clearance_px: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.minimum(clearance_px, 0) ** 2))) if len(clearance_px) else 0.0


def _body_sphere(views: list[View], overruled: int) -> tuple[NDArray[np.float64], float] | None:
    """Centre (3,) and radius in mm of a sphere around the hull, from a coarse grid; `None` without a hull."""
    pitch_mm, half_mm = 2.0, 30.0
    axis_mm = np.arange(-half_mm, half_mm + pitch_mm / 2, pitch_mm, dtype=np.float32)
    points_mm = np.stack(np.meshgrid(axis_mm, axis_mm, axis_mm, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = points_mm[smallest(distances_mm(views, points_mm), overruled) > -pitch_mm * np.sqrt(3) / 2]
    if len(inside) == 0:
        return None
    low, high = inside.min(axis=0), inside.max(axis=0)
    return ((low + high) / 2).astype(np.float64), float(np.linalg.norm(high - low) / 2 + pitch_mm)


def _clearances_px(
    views: list[View], sphere: tuple[NDArray[np.float64], float], overruled: int
) -> list[NDArray[np.float64]]:
    """Per view the clearances (RAYS,) in px of its outline's rays in the field of the other views.

    The highest value along a ray is sought on ever shorter stretches: where the body touches the ray
    with a sharp corner the peak is narrow.
    """
    center_mm, radius_mm = sphere
    clearances = []
    for index, (camera, silhouette) in enumerate(views):
        n = len(silhouette.outline_uv)
        chosen = silhouette.outline_uv[np.linspace(0, n, min(RAYS, n), endpoint=False).astype(int)]
        directions = camera.rays(chosen)
        others = views[:index] + views[index + 1 :]
        closest_mm = directions @ (center_mm - camera.center_mm)
        peak_mm, reach_mm = closest_mm, radius_mm
        highest_mm: NDArray[np.floating] = np.zeros(len(chosen))
        for steps in STEPS:
            along_mm = peak_mm[:, None] + np.linspace(-reach_mm, reach_mm, steps)
            points_mm = camera.center_mm + along_mm[..., None] * directions[:, None]
            values = smallest(distances_mm(others, points_mm.reshape(-1, 3).astype(np.float32)), overruled)
            values = values.reshape(len(chosen), steps)
            best = values.argmax(axis=1, keepdims=True)
            peak_mm = np.take_along_axis(along_mm, best, axis=1)[:, 0]
            highest_mm = np.take_along_axis(values, best, axis=1)[:, 0]
            reach_mm *= 2 / (steps - 1)
        clearances.append(highest_mm * camera.focal_px / np.maximum(closest_mm, 1.0))
    return clearances
