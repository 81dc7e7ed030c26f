"""Evidence of the chain on the visibility of one stone: collected here, judged in `model`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import PointsMM
from pipeline.frames import CameraId
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN, Silhouette
from pipeline.view_optics import ViewOptics
from pipeline.views.consistency import Consistency
from pipeline.views.prepared import PreparedViews
from pipeline.views.quality import share_unseen

WALL_GREY = 200.0
"""Level of the wall that the exposure of a rig is set to."""
MAX_SIGMA_PX = 10.0
"""Blur of an edge that is wider than any that can be measured."""
TYPICAL_NOISE_GREY = 2.0
"""Noise of a view of which no optics are known, since nothing is known of it without the stone."""
TYPICAL_CONTRAST = 0.5
"""Contrast of an outline whose profile has no plateau, as a share of the wall's level."""
LENGTH_SD_PERCENT = 0.05
"""Standard deviation of the scale of a calibration: an offset of all outlines by 0.1 px, which balls of one size do not
show, is 0.05 % of a ball of 10 mm."""
RMS_PX = 0.05
"""Residual of a calibration that does not state its own."""
SAMPLED_VERTICES = 2000
RING_PX = np.rint(3 * np.stack([f(np.arange(8) * np.pi / 4) for f in (np.cos, np.sin)])).astype(np.int64)
"""Places (2, 8) around a pixel; an edge that passes it has both sides there, and hull and outline differ by less."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewEvidence:
    """Quality of the stone's outline in one view; lengths in pixels of `pixel_mm` at the stone."""

    pixel_mm: float
    edge_sigma_px: float  # blur of the edge, all of it
    motion_sigma_px: float  # the part of it that lies along the fall
    noise_grey: float
    step_grey: float  # height of the edge
    undecided_share: float  # of the area that may be body: unknown, where the edge was not seen
    calibration_px: float  # residual of the camera's calibration
    tangency_px: float | None  # epipolar residual against the other views, None where no pair shows it
    residual_px: float  # rms by which the outline leaves the hull of the others


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelSupport:
    """What the pixels inside the outlines say of how deep the surface lies, beside what the outlines say."""

    share: float = 0.0  # of the surface, where they say it
    blank_share: float = 1.0  # of the surface, where neither they nor those around do
    depth_mm: float = 0.0  # rms by which they shift what they support from where the outlines have it
    relief_mm: float = 0.0  # rms of the finest relief that they show there


UNSUPPORTED = PixelSupport()
"""Support of a surface of which pixels say nothing, or were not asked."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """Quality of the views used of one stone, and of the hull that they leave."""

    views: tuple[ViewEvidence, ...]
    volume_mm3: float
    area_mm2: float
    hull_mm3: float
    is_estimated: bool  # False: the body is the hull
    length_sd_percent: float
    open_share: float = 0.0  # of the hull's surface, that no outline bounds which was seen
    pixels: PixelSupport = UNSUPPORTED


def view_evidence(
    views: PreparedViews, optics: Mapping[CameraId, ViewOptics], consistency: Consistency
) -> tuple[ViewEvidence, ...]:
    """Collect the evidence of each of the views that carved a stone."""
    motion_px = _motion_sigma_px(views.silhouettes)
    seen = []
    for camera, silhouette in zip(views.calibrations, views.silhouettes, strict=True):
        of_view = optics.get(camera.id)
        noise_grey = TYPICAL_NOISE_GREY if of_view is None else of_view.noise_grey
        contrast = None if of_view is None else of_view.contrast
        sigma_px = silhouette.edge_sigma_px
        seen.append(
            ViewEvidence(
                pixel_mm=float(np.linalg.norm(camera.center_mm)) / camera.focal_px,
                edge_sigma_px=MAX_SIGMA_PX if sigma_px is None else sigma_px,
                motion_sigma_px=motion_px,
                noise_grey=noise_grey,
                step_grey=WALL_GREY * (TYPICAL_CONTRAST if contrast is None else contrast),
                undecided_share=_undecided_share(silhouette),
                calibration_px=RMS_PX if camera.rms_px is None else camera.rms_px,
                tangency_px=consistency.tangency_px.get(camera.id),
                residual_px=consistency.residuals_px.get(camera.id, 0.0),
            )
        )
    return tuple(seen)


def open_share(views: PreparedViews, hull_mm: PointsMM) -> float:
    """Return the share of the hull's vertices (N, 3) that no view has on an edge which it saw.

    They lie on the border of what is unknown in one view and within the outlines of all others: the body may end
    anywhere below. What is unknown in one view alone leaves little open, since the others carve there.
    """
    some_mm = hull_mm[:: max(1, len(hull_mm) // SAMPLED_VERTICES)]
    is_bounded = np.zeros(len(some_mm), np.bool_)
    for camera, silhouette in zip(views.calibrations, views.silhouettes, strict=True):
        left = np.flatnonzero(~is_bounded)
        at_uv = np.rint(camera.project(some_mm[left])[0]).astype(np.int64) - silhouette.offset_uv
        height, width = silhouette.labels.shape
        columns, rows = (at_uv.T[:, None] + RING_PX[:, :, None]).clip(0, [[[width - 1]], [[height - 1]]])
        around = silhouette.labels[rows, columns]
        has = [(around == label).any(axis=0) for label in (INSIDE, OUTSIDE, UNKNOWN)]
        is_bounded[left] = has[0] & has[1] & ~has[2]
    return float(np.mean(~is_bounded))


def _undecided_share(silhouette: Silhouette) -> float:
    """Return the share of unknown area, at most that of unseen outline: within a seen edge it is body."""
    unseen = share_unseen(silhouette)
    if unseen == 0:
        return 0.0
    n_unknown, n_body = (
        int(np.count_nonzero(of)) for of in (silhouette.labels == UNKNOWN, silhouette.labels)
    )
    return min(n_unknown / max(n_body, 1), unseen)


def _motion_sigma_px(silhouettes: Sequence[Silhouette]) -> float:
    """Return the sigma of the blur that all views have along one axis of their images: a stone falls in all of them.

    The depth of a stone blurs single views along an axis, but not most of them along the same.
    """
    differences = [
        v_px**2 - u_px**2 for u_px, v_px in filter(None, (seen.sigmas_across_px for seen in silhouettes))
    ]
    return float(np.sqrt(abs(np.median(differences)))) if differences else 0.0
