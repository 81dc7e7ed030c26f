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

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration.tangency import (
    EpipolarTangents,
    epipolar_tangents,
    image_shifts_px,
    outlines_of,
    tangency_scores_px,
)
from pipeline.carving import View, distances_mm, usable_views
from pipeline.frames import CameraId
from pipeline.rig import CameraCalibration, RigCalibration
from pipeline.segmentation.silhouette import MARGIN_PX, Silhouette

Array = NDArray[np.float64]

RAYS = 64
"""Rays a view, spread evenly over its outline."""
STEPS = (40, 9, 9)
"""Samples a ray within the sphere around the body, then around the highest of the last ones."""
ROUNDING_MM = 1e-3
HOPELESS_MM = -0.5
"""Samples that far outside are given up first; only where a ray has no better ones are they taken up again."""


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Judgement:
    """The clearances of some views in the field of the others, and the view they speak against."""

    views: Sequence[View]
    sphere: tuple[Array, float]  # around the hull: centre (3,) and radius in mm
    clearances_px: Sequence[Array]  # one for each view, of each of its rays
    worst: CameraId | None
    problem: str = ""


def check_consistency(
    silhouettes: Mapping[CameraId, Silhouette], rig: RigCalibration, parameters: ConsistencyParameters
) -> Consistency:
    """Residuals of every usable view, and the views that contradict the rest.

    Views that tangency names are dropped first. Where the tangents of the rest agree, all of their votes are
    counted: if nothing contradicts even then, that is all. If something does, they are judged carefully.
    """
    tangents = epipolar_tangents(outlines_of(silhouettes), rig)
    tangency_px = tangency_scores_px(tangents)
    agreeing = {camera for camera, score_px in tangency_px.items() if score_px <= parameters.max_tangency_px}
    suspects, is_consistent = displaced_views(tangents, parameters)
    views = [view for view in usable_views(silhouettes, rig) if view[0].id not in suspects]
    judgement = None
    if all(camera.id in agreeing for camera, _ in views):
        judgement = _judgement(views, 0, agreeing, parameters)
    if judgement is None or judgement.worst is not None:
        judgement, contradicting = _careful_judgement(views, len(suspects), agreeing, parameters)
        suspects |= contradicting
    return Consistency(
        residuals_px={} if judgement is None else _residuals_px(judgement),
        suspects=suspects,
        is_consistent=is_consistent and judgement is not None and judgement.worst is None,
        tangency_px=tangency_px,
        image_shifts_px=image_shifts_px(tangents),
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


def _careful_judgement(
    views: Sequence[View], n_suspects: int, agreeing: Collection[CameraId], parameters: ConsistencyParameters
) -> tuple[_Judgement | None, dict[CameraId, str]]:
    """The last judgement, `None` without a hull, and the views that were dropped on the way to it, worst first.

    The worst is dropped and the others judged again, until all agree or no more may be dropped. While r more
    may be, r votes against a point are not counted, so that a bad view does not condemn the good ones.
    """
    suspects: dict[CameraId, str] = {}
    while True:
        n_left = parameters.max_suspect_views - n_suspects - len(suspects)
        overruled = max(min(n_left, len(views) - 3), 0)
        judgement = _judgement(views, overruled, agreeing, parameters)
        if judgement is None or judgement.worst is None or n_left == 0:
            break
        suspects[judgement.worst] = f"contradicts the other views: {judgement.problem}"
        views = [view for view in views if view[0].id != judgement.worst]
    if judgement is not None and overruled > 0:
        all_counted_px = _clearances_px(views, judgement.sphere, 0)
        judgement = replace(judgement, clearances_px=all_counted_px)
    return judgement, suspects


def _judgement(
    views: Sequence[View], overruled: int, agreeing: Collection[CameraId], parameters: ConsistencyParameters
) -> _Judgement | None:
    """What the views' field says with `overruled` votes against each point not counted; `None` without a hull."""
    sphere = _body_sphere(views, overruled)
    if sphere is None:
        return None
    clearances_px = _clearances_px(views, sphere, overruled)
    worst, problem, score = None, "", 1.0
    for (camera, _), clearance_px in zip(views, clearances_px, strict=True):
        claimed = _rms_outside(clearance_px) / parameters.max_residual_px
        # what an agreeing view excludes, no other knows of: the hull without it is that much larger
        denied = 0.0 if camera.id in agreeing else _denied(clearance_px, camera, sphere[1], parameters)
        if max(claimed, denied) > score:
            worst, score = camera.id, max(claimed, denied)
            problem = "claims a body that other views exclude" if claimed > denied else "denies the body"
    return _Judgement(views=views, sphere=sphere, clearances_px=clearances_px, worst=worst, problem=problem)


def _denied(
    clearance_px: Array, camera: CameraCalibration, radius_mm: float, parameters: ConsistencyParameters
) -> float:
    """How much of the body a view denies: above 1, too much."""
    if len(clearance_px) == 0:
        return 0.0
    # the smallest diameter of a body in a sphere around its box is some 1 / sqrt(3) of the sphere's
    diameter_px = 1.2 * radius_mm * camera.focal_px / float(np.linalg.norm(camera.center_mm))
    # clearances are cut off like the distances they come from
    return float(np.median(clearance_px)) / min(parameters.max_denied_share * diameter_px, 0.7 * MARGIN_PX)


def _residuals_px(judgement: _Judgement) -> dict[CameraId, float]:
    return {
        camera.id: _rms_outside(clearance_px)
        for (camera, _), clearance_px in zip(judgement.views, judgement.clearances_px, strict=True)
    }


def _rms_outside(clearance_px: Array) -> float:
    return float(np.sqrt(np.mean(np.minimum(clearance_px, 0) ** 2))) if len(clearance_px) else 0.0


def _body_sphere(views: Sequence[View], overruled: int) -> tuple[Array, float] | None:
    """Centre (3,) and radius in mm of a sphere around the hull, from a coarse grid; `None` without a hull."""
    pitch_mm, half_mm = 2.0, 30.0
    axis_mm = np.arange(-half_mm, half_mm + pitch_mm / 2, pitch_mm, dtype=np.float32)
    points_mm = np.stack(np.meshgrid(axis_mm, axis_mm, axis_mm, indexing="ij"), axis=-1).reshape(-1, 3)
    votes_against = np.zeros(len(points_mm), np.int64)
    for view in views:
        votes_against += distances_mm([view], points_mm)[0] <= -pitch_mm * np.sqrt(3) / 2
        is_left = votes_against <= overruled
        points_mm, votes_against = points_mm[is_left], votes_against[is_left]
    if len(points_mm) == 0:
        return None
    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    return ((low + high) / 2).astype(np.float64), float(np.linalg.norm(high - low) / 2 + pitch_mm)


def _clearances_px(views: Sequence[View], sphere: tuple[Array, float], overruled: int) -> list[Array]:
    """Per view the clearances (RAYS,) in px of its outline's rays in the field of the other views.

    The highest value along a ray is sought on ever shorter stretches: where the body touches the ray
    with a sharp corner the peak is narrow.
    """
    center_mm, radius_mm = sphere
    chosen_uv = [_spread(silhouette.outline_uv) for _, silhouette in views]
    owners = np.repeat(np.arange(len(views)), [len(chosen) for chosen in chosen_uv])
    eyes_mm = np.array([camera.center_mm for camera, _ in views])[owners]
    directions = np.concatenate([camera.rays(uv) for (camera, _), uv in zip(views, chosen_uv, strict=True)])
    closest_mm = ((center_mm - eyes_mm) * directions).sum(axis=1)
    peak_mm, reach_mm, highest_mm = closest_mm, radius_mm, np.full(len(owners), HOPELESS_MM)
    for steps in STEPS:
        along_mm = peak_mm[:, None] + np.linspace(-reach_mm, reach_mm, steps)
        points_mm = eyes_mm[:, None] + along_mm[..., None] * directions[:, None]
        best, highest_mm = _highest(
            views, points_mm.astype(np.float32), owners, overruled, highest_mm - ROUNDING_MM
        )
        peak_mm = along_mm[np.arange(len(owners)), best]
        reach_mm *= 2 / (steps - 1)
    focal_px = np.array([camera.focal_px for camera, _ in views])[owners]
    clearances_px = highest_mm * focal_px / np.maximum(closest_mm, 1.0)
    return [clearances_px[owners == view] for view in range(len(views))]


def _spread(outline_uv: Array) -> Array:
    """At most `RAYS` points, evenly spread over an outline (N, 2)."""
    n = len(outline_uv)
    return outline_uv[np.linspace(0, n, min(RAYS, n), endpoint=False).astype(int)]


def _highest(
    views: Sequence[View],
    points_mm: NDArray[np.float32],
    owners: NDArray[np.int64],
    overruled: int,
    at_least_mm: Array,
) -> tuple[NDArray[np.int64], Array]:
    """Of the samples (R, S, 3) of each ray the one highest in the field of the views but its owner, and its value.

    A sample is given up as soon as so many views have it below `at_least_mm` (R,) that its value must be; after
    three or four views few are left.
    """
    n_rays, n_samples, _ = points_mm.shape
    values_mm = np.full((n_rays, n_samples), -np.inf, np.float32)
    sample, left_mm = np.arange(values_mm.size), points_mm.reshape(-1, 3)
    owner, bound_mm = np.repeat(owners, n_samples), np.repeat(at_least_mm, n_samples)
    smallest_mm = np.full((overruled + 1, len(sample)), np.inf, np.float32)  # so far, in order
    for index, view in enumerate(views):
        found_mm = distances_mm([view], left_mm)[0]
        found_mm[owner == index] = np.inf
        for kept_mm in smallest_mm:
            kept_mm[:], found_mm = np.minimum(kept_mm, found_mm), np.maximum(kept_mm, found_mm)
        is_left = np.flatnonzero(smallest_mm[-1] > bound_mm)
        sample, left_mm, smallest_mm = sample[is_left], left_mm[is_left], smallest_mm[:, is_left]
        owner, bound_mm = owner[is_left], bound_mm[is_left]
    values_mm.ravel()[sample] = smallest_mm[-1]
    best, highest_mm = values_mm.argmax(axis=1), values_mm.max(axis=1)
    given_up = np.isneginf(highest_mm) & np.isfinite(at_least_mm)
    if given_up.any():
        best[given_up], highest_mm[given_up] = _highest(
            views, points_mm[given_up], owners[given_up], overruled, np.full(given_up.sum(), -np.inf)
        )
    return best, highest_mm
