"""Build the segmenter of a worker from the model that the service has read.

A model file that is missing or damaged does not stop the daemon: stones are measured without the network, and every
result says so.
"""

import logging
from dataclasses import dataclass

import numpy as np

from pipeline.errors import ModelError
from pipeline.frames import CameraId, Frame
from pipeline.segmentation import Segmenter, segmenter_choice
from pipeline.segmentation.background import CameraBackground
from pipeline.segmentation.mask_segmenter import MaskSegmenter, imported_mask
from pipeline.segmentation.network import Network, available_providers, load_network
from pipeline.segmentation.network_segmenter import NetworkSegmenter
from pipeline.segmentation.segmenter_choice import ChoosingSegmenter, SegmenterKind
from pipeline.segmentation.subtraction import BackgroundSegmenter, SegmentationParameters
from service.base.messages import Code, message

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmenterPlan:
    """Plan of a worker's segmenter; by default only the comparison with the background."""

    wanted: SegmenterKind = "background"
    model: bytes | None = None  # content of an ONNX file
    providers: tuple[str, ...] = ()
    trouble: str | None = None  # why there is no model
    provider_trouble: str | None = None  # why the model does not run on the configured provider
    takes_masks: bool = False  # images are masks: nothing is to be found

    @property
    def warning(self) -> str | None:
        """Why the configured segmenter is not used, or not as configured; None when it is."""
        if self.trouble is not None:
            return message(Code.SEGMENTATION_CLASSICAL, reported=self.trouble)
        return self.provider_trouble and message(Code.NETWORK_TROUBLED, reported=self.provider_trouble)


CLASSICAL = SegmenterPlan()
"""The plan without a network: only the comparison with the background."""


def build_segmenter(plan: SegmenterPlan, parameters: SegmentationParameters) -> Segmenter:
    """Return the segmenter of a plan; without the network if this process cannot load it."""
    if plan.takes_masks:
        return imported_mask
    network: Network | None = None
    if plan.model is not None:
        try:
            network = load_network(plan.model, plan.providers or available_providers())
        except ModelError as err:
            log.error("classical mode: %s", err)
        else:
            if network.fallback is not None:
                log.warning("segmentation: %s", network.fallback)
    if plan.wanted == "mask" and network is not None:
        return MaskSegmenter(network)
    return ChoosingSegmenter(
        classical=BackgroundSegmenter(parameters),
        network=None if network is None else NetworkSegmenter(network, parameters),
        wanted="auto" if plan.wanted == "mask" else plan.wanted,  # each result then says what is missing
    )


def warm_up(segmenter: Segmenter) -> None:
    """Compile and allocate what segmentation needs, by segmenting squares, so that the first stone need not wait."""
    segmenter_choice.warm_up()
    asked = segmenter.network if isinstance(segmenter, ChoosingSegmenter) else segmenter
    if asked is None:
        return
    wall = np.full((256, 320), 200, np.float32)
    image = wall.astype(np.uint8)
    image[100:150, 140:190] = 60
    frame = Frame(camera=CameraId("warm-up"), image=image, frame_id=0, device_ns=0, received_ns=0)
    background = {frame.camera: CameraBackground(mean=wall, n_frames=1)}
    _ = asked(frame, background).fine_px
