"""The quality of a result by the views it rests on, or the rejection of a stone that too few cameras saw well."""

from collections.abc import Collection
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from pipeline.arrays import Values
from pipeline.errors import RejectedError, RejectReason
from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation import Silhouette, SilhouetteSet, ViewStatus
from pipeline.views.dropped import DropCause, DroppedView

LAYER_TOLERANCE_DEG = 10.0
"""Difference in elevation below which cameras belong to one layer."""


class Quality(StrEnum):
    """Grade of a result: by the number of views it rests on, and by its uncertainty."""

    GOOD = "good"
    REDUCED = "reduced"
    DEGRADED = "degraded"


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewsParameters:
    """Numbers of views that make a result good, reduced or degraded, or the stone rejected."""

    good: int = 14  # at least so many views make a good result
    reduced: int = 12
    min: int = 8  # fewer are not measured
    max_unusable: int = 2  # views showing several bodies, or a cut one, before the whole bundle is rejected
    max_unseen_share: float = 0.95  # of the outline, in half of the views

    def __post_init__(self) -> None:
        if not 2 <= self.min <= self.reduced <= self.good:
            raise ValueError("views need 2 <= min <= reduced <= good")
        if self.max_unusable < 0:
            raise ValueError("max_unusable must not be negative")
        if not 0 < self.max_unseen_share <= 1:
            raise ValueError("max_unseen_share must be in 0..1")


def share_unseen(silhouette: Silhouette) -> float:
    """Return the share of the points around a silhouette, about a pixel apart, where no edge was seen, 0..1."""
    return 1 - len(silhouette.outline_uv) / max(len(silhouette.reach_uv), 1)


def unusable_views(silhouettes: SilhouetteSet) -> dict[CameraId, DroppedView]:
    """Return the views that show no body, a cut one or several, with their status."""
    return {
        camera: DroppedView(DropCause.UNUSABLE, silhouette.status)
        for camera, silhouette in silhouettes.items()
        if not silhouette.is_usable
    }


def require_enough_views(
    silhouettes: SilhouetteSet,
    dropped: Collection[CameraId],
    rig: RigCalibration,
    parameters: ViewsParameters,
) -> None:
    """Reject a stone that too few cameras saw well.

    Raises
    ------
    RejectedError
        Most views show no body, or several show more than one or a cut one, or hardly any of the outline is seen, or
        too few are not dropped.
    """
    shown = [silhouette.status for silhouette in silhouettes.values()]
    n_of = {status: shown.count(status) for status in ViewStatus}
    if n_of[ViewStatus.EMPTY] > len(shown) / 2:
        raise RejectedError(RejectReason.EMPTY, f"{n_of[ViewStatus.EMPTY]} of {len(shown)} views are empty")
    if n_of[ViewStatus.NO_BACKGROUND] > len(shown) / 2:
        raise RejectedError(RejectReason.NO_BACKGROUND, "the empty rig was not exposed yet")
    if n_of[ViewStatus.MULTIPLE] > parameters.max_unusable:
        raise RejectedError(
            RejectReason.MULTIPLE, f"{n_of[ViewStatus.MULTIPLE]} views show more than one body"
        )
    if n_of[ViewStatus.CLIPPED] > parameters.max_unusable:
        raise RejectedError(
            RejectReason.CLIPPED, f"the body leaves the image in {n_of[ViewStatus.CLIPPED]} views"
        )
    left = [camera for camera in silhouettes if camera not in dropped]
    unseen = [share_unseen(silhouettes[camera]) for camera in left]
    if unseen and np.median(unseen) > parameters.max_unseen_share:
        raise RejectedError(
            RejectReason.UNSEEN,
            f"in half of the views {np.median(unseen):.0%} or more of the outline is not seen",
        )
    quality_of(rig.subset(left), rig, parameters)


def shows_several(silhouettes: SilhouetteSet) -> bool:
    """True when any view shows more than one body, so that its evidence is missing."""
    return any(silhouette.status is ViewStatus.MULTIPLE for silhouette in silhouettes.values())


def quality_of(used: RigCalibration, rig: RigCalibration, parameters: ViewsParameters) -> Quality:
    """Return the quality by the number of views used; below `reduced` every layer of cameras needs two.

    Raises
    ------
    RejectedError
        There are too few views.
    """
    n_views = len(used.cameras)
    if n_views >= parameters.reduced:
        return Quality.GOOD if n_views >= parameters.good else Quality.REDUCED
    if n_views < parameters.min:
        raise RejectedError(
            RejectReason.INSUFFICIENT_VIEWS, f"{n_views} usable views, {parameters.min} are needed"
        )
    elevations, all_elevations = _elevations_deg(used), _elevations_deg(rig)
    for elevation in all_elevations:
        in_layer = int(np.sum(np.abs(elevations - elevation) < LAYER_TOLERANCE_DEG))
        if in_layer < min(2, int(np.sum(np.abs(all_elevations - elevation) < LAYER_TOLERANCE_DEG))):
            raise RejectedError(
                RejectReason.INSUFFICIENT_VIEWS,
                f"{in_layer} usable views in the layer at {elevation:.0f} degrees",
            )
    return Quality.DEGRADED


def _elevations_deg(rig: RigCalibration) -> Values:
    """Return the elevation (V,) of each camera above the horizontal plane through the rig's centre."""
    centers_mm = np.array([camera.center_mm for camera in rig.cameras]).reshape(-1, 3)
    return np.asarray(np.rad2deg(np.arcsin(centers_mm[:, 2] / np.linalg.norm(centers_mm, axis=1))))
