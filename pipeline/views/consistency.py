"""Checking that the views show one rigid body, and finding the view that does not.

There are two tests. Epipolar tangency (`pipeline.views.epipolar_tangency`) compares views in pairs: it sees a tenth of
a pixel, names the one view that is wrong whatever its error does to the hull, and needs no hull. What it cannot
see, such as a bay that one view fills, the hull shows:

Every point of a silhouette's edge is the image of a point of the body: the viewing ray through it
must touch the body, hence the hull of the other views. Its clearance (`pipeline.views.clearance`) is about zero or
a little above for a consistent view (the hull is never smaller than the body), negative where the view shows
a body that others exclude, and large where it excludes a body that all others see.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from pipeline.arrays import Values
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration
from pipeline.rig.design import nominal_rig
from pipeline.segmentation.ball_silhouettes import ball_silhouettes
from pipeline.segmentation.silhouette import MARGIN_PX
from pipeline.views.agreeing_views import negative_clearances_px
from pipeline.views.clearance import Sphere, body_sphere, clearances_px
from pipeline.views.distance_field import distance_field
from pipeline.views.dropped import DropCause, DroppedView
from pipeline.views.epipolar_tangency import (
    EpipolarTangents,
    hulls_of_views,
    image_shifts_px,
    pairwise_tangents,
    tangency_scores_px,
)
from pipeline.views.prepared import PreparedViews, prepare_views


@dataclass(frozen=True, slots=True, kw_only=True)
class ConsistencyParameters:
    """Limits beyond which a view contradicts the others."""

    max_suspect_views: int = 4  # that may be dropped, a quarter of all at most; more mean a bundle to reject
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
    """Residuals of one stone's views against each other, and the views to drop."""

    residuals_px: Mapping[CameraId, float]  # rms by which a view's outline leaves the hull of the others
    suspects: Mapping[CameraId, DroppedView]  # views to drop, worst first, with what is wrong with them
    is_consistent: bool  # the views that are left after dropping them agree
    tangency_px: Mapping[CameraId, float]  # median epipolar residual of a view, dropped ones included
    image_shifts_px: Mapping[CameraId, tuple[float, float]]  # of a view against where the others expect it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Judgement:
    """The clearances of views in the field of the others, and the view that contradicts them most."""

    views: PreparedViews
    sphere: Sphere  # around the hull
    clearances_px: Sequence[Values]  # one for each ray of each view; of agreeing views below zero only
    worst: CameraId | None
    problem: str = ""


def check_consistency(views: PreparedViews, parameters: ConsistencyParameters) -> Consistency:
    """Compute the residuals of all views, and find the views that contradict the rest.

    Views that tangency names are dropped first. Where the tangents of the rest agree, all of their votes are
    counted: if nothing contradicts even then, that is all. If something does, they are judged carefully.
    """
    outlined = views.with_outline()
    hulls = hulls_of_views(outlined.camera_ids, outlined.cameras, outlined.outlines)
    tangents = pairwise_tangents(hulls, outlined.cameras)
    tangency_px = tangency_scores_px(tangents)
    agreeing = {camera for camera, score_px in tangency_px.items() if score_px <= parameters.max_tangency_px}
    suspects, is_consistent = displaced_views(tangents, tangency_px, parameters)
    left = views.without(suspects)
    residuals_px: dict[CameraId, float] = {}
    if agreeing.issuperset(left.camera_ids):
        residuals_px = _residuals_px(left, negative_clearances_px(left, hulls))
    if max(residuals_px.values(), default=np.inf) > parameters.max_residual_px:
        judgement, contradicting = _careful_judgement(left, len(suspects), agreeing, parameters)
        suspects |= contradicting
        is_consistent &= judgement is not None and judgement.worst is None
        residuals_px = {} if judgement is None else _residuals_px(judgement.views, judgement.clearances_px)
    return Consistency(
        residuals_px=residuals_px,
        suspects=suspects,
        is_consistent=is_consistent,
        tangency_px=tangency_px,
        image_shifts_px=image_shifts_px(tangents),
    )


def warm_up() -> Consistency:
    """Check the views of a made-up ball, which compiles all that the first stone would wait for."""
    rig = nominal_rig()
    return check_consistency(prepare_views(ball_silhouettes(rig), rig), ConsistencyParameters())


def displaced_views(
    tangents: EpipolarTangents, tangency_px: Mapping[CameraId, float], parameters: ConsistencyParameters
) -> tuple[dict[CameraId, DroppedView], bool]:
    """Find views that their tangents' scores alone show to be wrong, worst first, and whether these are all of them."""
    suspects: dict[CameraId, DroppedView] = {}
    n_most = min(parameters.max_suspect_views, len(tangency_px) // 4)
    scores_px = dict(tangency_px)
    while scores_px:
        worst = max(scores_px, key=lambda camera: scores_px[camera])
        score_px = scores_px.pop(worst)
        if not scores_px or score_px <= max(
            parameters.max_tangency_px,
            parameters.max_tangency_ratio * float(np.median(list(scores_px.values()))),
        ):
            break
        if len(suspects) == n_most:
            return suspects, False
        suspects[worst] = DroppedView(
            DropCause.CONTRADICTION, f"its tangents miss theirs by {score_px:.1f} px"
        )
        scores_px = tangency_scores_px(tangents, without=suspects)
    return suspects, True


def _careful_judgement(
    views: PreparedViews, n_suspects: int, agreeing: Collection[CameraId], parameters: ConsistencyParameters
) -> tuple[_Judgement | None, dict[CameraId, DroppedView]]:
    """Return the last judgement, `None` without a hull, and the views that were dropped on the way, worst first.

    The worst is dropped and the others judged again, until all agree or no more may be dropped: half as many as by
    tangents, which name the view that is wrong. While r more may be, r votes against a point are not counted, so that
    a bad view does not condemn the good ones.
    """
    suspects: dict[CameraId, DroppedView] = {}
    while True:
        n_left = max(parameters.max_suspect_views // 2 - n_suspects - len(suspects), 0)
        overruled = max(min(n_left, len(views) - 3), 0)
        judgement = _judgement(views, overruled, agreeing, parameters)
        if judgement is None or judgement.worst is None or n_left == 0:
            break
        suspects[judgement.worst] = DroppedView(DropCause.CONTRADICTION, judgement.problem)
        views = views.without([judgement.worst])
    if judgement is not None and overruled > 0:
        field = distance_field(views, overruled=0)
        all_counted_px = clearances_px(views, field, judgement.sphere, views.camera_ids)
        judgement = replace(judgement, clearances_px=all_counted_px)
    return judgement, suspects


def _judgement(
    views: PreparedViews, overruled: int, agreeing: Collection[CameraId], parameters: ConsistencyParameters
) -> _Judgement | None:
    """Judge the views with `overruled` votes against each point not counted; `None` without a hull."""
    field = distance_field(views, overruled)
    sphere = body_sphere(field)
    if sphere is None:
        return None
    found_px = clearances_px(views, field, sphere, settled_above_zero=agreeing)
    worst, problem, score = None, "", 1.0
    for camera, clearance_px in zip(views.calibrations, found_px, strict=True):
        claimed = _rms_outside(clearance_px) / parameters.max_residual_px
        # no other view shows what an agreeing one excludes: the hull without it is that much larger
        denied = 0.0 if camera.id in agreeing else _denied_ratio(clearance_px, camera, sphere[1], parameters)
        if max(claimed, denied) > score:
            worst, score = camera.id, max(claimed, denied)
            problem = "claims a body that other views exclude" if claimed > denied else "denies the body"
    return _Judgement(views=views, sphere=sphere, clearances_px=found_px, worst=worst, problem=problem)


def _denied_ratio(
    clearance_px: Values, camera: CameraCalibration, radius_mm: float, parameters: ConsistencyParameters
) -> float:
    """Median distance by which a view excludes points of the others, as a ratio to its limit: above 1, too far."""
    if len(clearance_px) == 0:
        return 0.0
    # the smallest diameter of a body in a sphere around its box is some 1 / sqrt(3) of the sphere's
    diameter_px = 1.2 * radius_mm * camera.focal_px / float(np.linalg.norm(camera.center_mm))
    # clearances are cut off like the distances they come from
    return float(np.median(clearance_px)) / min(parameters.max_denied_share * diameter_px, 0.7 * MARGIN_PX)


def _residuals_px(views: PreparedViews, found_px: Sequence[Values]) -> dict[CameraId, float]:
    """Return the residual of each view, whose rays have these clearances."""
    return {
        camera: _rms_outside(clearance_px)
        for camera, clearance_px in zip(views.camera_ids, found_px, strict=True)
    }


def _rms_outside(clearance_px: Values) -> float:
    """Return the rms of the clearances (R,) below zero, over all rays."""
    outside_px = np.minimum(clearance_px, 0)
    return sqrt(outside_px @ outside_px / max(len(outside_px), 1))
