"""The usable views of one stone, prepared once: view checking, carving and the estimate take the same value."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from pipeline.frames import CameraId
from pipeline.rig.camera_arrays import CameraArrays, camera_arrays
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.segmentation.silhouette import Silhouette
from pipeline.views.outline_hull import MIN_POINTS, StackedOutlines, stack_outlines


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PreparedViews:
    """V calibrated cameras with their usable silhouettes, in the rig's order."""

    calibrations: tuple[CameraCalibration, ...]  # V
    cameras: CameraArrays  # the same, as arrays
    silhouettes: tuple[Silhouette, ...]  # V
    outlines: StackedOutlines  # of these silhouettes, where the edge was seen
    borders: StackedOutlines  # around all that may be body

    def __len__(self) -> int:
        return len(self.calibrations)

    @property
    def camera_ids(self) -> tuple[CameraId, ...]:
        """Ids (V,) of the cameras."""
        return tuple(camera.id for camera in self.calibrations)

    def without(self, dropped: Collection[CameraId]) -> "PreparedViews":
        """Return the views but those of some cameras; this very value when it has none of them."""
        return self._subset([i for i, camera in enumerate(self.calibrations) if camera.id not in dropped])

    def with_outline(self) -> "PreparedViews":
        """Return the views whose outline has points enough for a convex hull; this very value when all have."""
        return self._subset([i for i, n in enumerate(self.outlines.lengths) if n >= MIN_POINTS])

    def _subset(self, kept: Sequence[int]) -> "PreparedViews":
        if len(kept) == len(self):
            return self
        silhouettes = tuple(self.silhouettes[i] for i in kept)
        return PreparedViews(
            calibrations=tuple(self.calibrations[i] for i in kept),
            cameras=self.cameras.subset(kept),
            silhouettes=silhouettes,
            outlines=stack_outlines([silhouette.outline_uv for silhouette in silhouettes]),
            borders=stack_outlines([silhouette.reach_uv for silhouette in silhouettes]),
        )


def prepare_views(
    silhouettes: Mapping[CameraId, Silhouette], rig: RigCalibration, dropped: Collection[CameraId] = ()
) -> PreparedViews:
    """Return the usable silhouettes that were not dropped, with their cameras, in the rig's order.

    Raises
    ------
    ValueError
        A silhouette of a camera that the rig does not know.
    """
    unknown = sorted(set(silhouettes) - set(rig.camera_ids))
    if unknown:
        raise ValueError(f"the rig has no camera {', '.join(unknown)}")
    calibrations = tuple(
        camera
        for camera in rig.cameras
        if camera.id in silhouettes and silhouettes[camera.id].is_usable and camera.id not in dropped
    )
    usable = tuple(silhouettes[camera.id] for camera in calibrations)
    return PreparedViews(
        calibrations=calibrations,
        cameras=camera_arrays(calibrations),
        silhouettes=usable,
        outlines=stack_outlines([silhouette.outline_uv for silhouette in usable]),
        borders=stack_outlines([silhouette.reach_uv for silhouette in usable]),
    )
