"""The sub-pixel outline of a ball in each view.

The segmentation puts the edge where half of a pixel is covered, that is at the grey level half-way between the
ball's and the background's, crossing by crossing. On rendered balls the fitted radius is then within 0.002 px of the
exact projection and the fitted centre scatters by 0.003 px, so the outline is not resampled here: points off the
ball's ellipse are removed, and views that do not show a whole ball are refused.
Motion during the exposure is symmetric in time and shifts neither centre nor radius.
"""

from statistics import median_low

import numpy as np

from pipeline.arrays import PointsUV
from pipeline.calibration.drops import BallDrop, BallView
from pipeline.calibration.ellipse import fit_ellipse
from pipeline.frames import CameraId, FrameBundle
from pipeline.segmentation import BackgroundModel, Segmenter, Silhouette, ViewStatus, segment_all

MIN_RADIUS_PX = 15.0
"""Smallest ball that is measured."""
MIN_INLIER_SHARE = 0.75
"""Least share of the outline on the ellipse; with less, another body covers too much of it."""
MAX_GAP_DEG = 100.0
"""Longest arc without an outline, hidden behind a dark aperture or another body."""
MAX_AXIS_DIFFERENCE = 0.02
"""Largest relative difference of the ellipse's axes; a sphere in the corner of the image has 0.009."""
MAX_RMS_PX = 0.5
"""Largest rms distance of the outline from the ellipse."""

REFUSALS = {
    ViewStatus.EMPTY: "shows no ball",
    ViewStatus.MULTIPLE: "shows several bodies",
    ViewStatus.CLIPPED: "the ball is cut off by the border of the image",
    ViewStatus.NO_BACKGROUND: "the empty view of this camera is unknown",
}
"""Reason to refuse a view, by the status of its silhouette."""


def observe_ball(
    bundle: FrameBundle, background: BackgroundModel, segmenter: Segmenter, diameter_mm: float | None
) -> BallDrop:
    """Return the ball of one exposure in all views that show it whole; the other views are refused with the reason."""
    views: dict[CameraId, BallView] = {}
    refused = {camera: f"no image: {reason}" for camera, reason in bundle.missing.items()}
    for camera, silhouette in segment_all(bundle.frames, background, segmenter).items():
        view = ball_view(silhouette)
        if isinstance(view, BallView):
            views[camera] = view
        else:
            refused[camera] = view
    return BallDrop(
        name=bundle.name,
        diameter_mm=diameter_mm,
        views=views,
        refused=refused,
        fall_ns=_fall_ns(bundle),
    )


def ball_view(silhouette: Silhouette) -> BallView | str:
    """Return the ball in one view, or the reason why it cannot be measured there."""
    if not silhouette.is_usable:
        return REFUSALS[silhouette.status]
    outline_uv = silhouette.outline_uv
    least_points = round(MIN_RADIUS_PX)
    if len(outline_uv) < least_points:
        return f"only {len(outline_uv)} points of the outline are seen"
    ellipse = fit_ellipse(outline_uv)
    inlier_share = float(ellipse.is_inlier.mean())
    if inlier_share < MIN_INLIER_SHARE:
        return f"not a ball: {100 * (1 - inlier_share):.0f} % of the outline is off the best ellipse"
    if not ellipse.radius_px >= MIN_RADIUS_PX:
        return f"too small to be measured: radius {ellipse.radius_px:.1f} px"
    difference = 2 * float(np.linalg.norm(ellipse.ellipticity_px)) / ellipse.radius_px
    if difference > MAX_AXIS_DIFFERENCE:
        return f"not round: the axes of the outline differ by {100 * difference:.1f} %"
    if ellipse.rms_px > MAX_RMS_PX:
        return f"rough: the outline is {ellipse.rms_px:.2f} px rms off its ellipse"
    kept_uv = outline_uv[ellipse.is_inlier]
    gap_deg = _max_gap_deg(kept_uv - ellipse.center_uv)
    if gap_deg > MAX_GAP_DEG:
        return f"an arc of {gap_deg:.0f} degrees of the outline is hidden"
    return BallView(
        outline_uv=kept_uv,
        center_uv=ellipse.center_uv,
        radius_px=ellipse.radius_px,
        rms_px=ellipse.rms_px,
        edge_sigma_px=silhouette.edge_sigma_px,
    )


def _max_gap_deg(offsets_uv: PointsUV) -> float:
    """Return the largest angle between neighbouring directions of points about the origin."""
    angles = np.sort(np.arctan2(offsets_uv[:, 1], offsets_uv[:, 0]))
    return float(np.rad2deg(np.diff(angles, append=angles[0] + 2 * np.pi).max()))


def _fall_ns(bundle: FrameBundle) -> int | None:
    """Return the time from the gate's pulse to the exposure, each by its own device's clock.

    The cameras' clocks differ: the median camera stands for all, the same one in all complete bundles.
    """
    if not bundle.frames:
        return None
    return median_low(frame.device_ns for frame in bundle.frames.values()) - bundle.trigger.device_ns
