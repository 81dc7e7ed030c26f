"""Where the body is in each image: silhouettes with sub-pixel edges."""

from collections.abc import Mapping
from typing import Protocol

from pipeline.frames import CameraId, Frame
from pipeline.segmentation.background import BackgroundModel
from pipeline.segmentation.silhouette import Silhouette, SilhouetteSet, ViewStatus
from pipeline.view_mapper import ViewMapper


class Segmenter(Protocol):
    """Finds the body in one view. The third of the three seams, beside `Camera` and `LightGate`."""

    def __call__(self, frame: Frame, background: BackgroundModel) -> Silhouette:
        """Return the silhouette, or a view whose `status` says why there is none. Never raises for an image."""
        ...


def segment_all(
    frames: Mapping[CameraId, Frame],
    background: BackgroundModel,
    segmenter: Segmenter,
    view_mapper: ViewMapper = map,
) -> SilhouetteSet:
    """Return one silhouette per frame, in the order of the frames."""
    silhouettes = view_mapper(lambda frame: segmenter(frame, background), frames.values())
    return dict(zip(frames, silhouettes, strict=True))


__all__ = ["BackgroundModel", "Segmenter", "Silhouette", "SilhouetteSet", "ViewStatus", "segment_all"]
