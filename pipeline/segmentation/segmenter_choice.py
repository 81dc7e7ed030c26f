"""The choice between background comparison and network, view by view.

Comparing with the empty rig is quick and unbiased as long as the wall around the body looks as it did
without it, and body and wall differ. Where that does not hold the network is asked. Each takes the
other's place where it finds nothing, and the silhouette says which of them it is from, and why.
"""

from dataclasses import dataclass, replace
from math import ceil
from typing import Literal, NamedTuple

import cv2
import numpy as np

from pipeline.arrays import GreyImage, PointsUV
from pipeline.compiled import compiled
from pipeline.errors import ModelError
from pipeline.frames import CameraId, Frame
from pipeline.segmentation import Segmenter
from pipeline.segmentation.background import BackgroundModel, CameraBackground
from pipeline.segmentation.noise import QUIET_GREY
from pipeline.segmentation.optics import observe_optics
from pipeline.segmentation.outline_bands import BandImages, band_shares
from pipeline.segmentation.silhouette import MARGIN_PX, MAX_STEP_PX, OUTSIDE, UNKNOWN, Silhouette, ViewStatus
from pipeline.segmentation.subtraction import BackgroundSegmenter, ComparedView

SegmenterKind = Literal["auto", "background", "onnx", "mask"]
"""The segmenter that is asked first; `auto`: background comparison, and the network where that is in doubt; `mask`: a
U2-Net whose mask alone is the silhouette, as in the paper."""

FRAME_BLOCKS = 4
"""Edge, in blocks of 4 px, of the blocks in which a view without a silhouette is looked at."""
PLAIN = 0.75
"""What is darker than this share of the wall is a screw, a vent or an aperture, or their blurred border."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChoiceParameters:
    """When the comparison with the background is in doubt."""

    max_light_error: float = 0.03  # of the wall beside the body; moves an edge of 2 px width by 0.05 px
    max_dim_share: float = 0.1  # of that wall with a greater error: the first sign of a slope or a shadow
    clear_contrast: float = 0.35  # of a body to the wall; dull stones have 0.4 and more
    max_faint_share: float = 0.06  # of the rim of a body with less; 5 mm across a screw have a twentieth
    max_unseen_share: float = 0.12  # of the outline; a screw hides 0.07 of that of a stone of 15 mm
    max_doubtful_share: float = 0.002  # of a view neither wall nor clearly different: a body of 4 mm
    max_dark_error: float = 0.02  # of the wall, where it is dark: four times what noise does to a block
    max_dark_share: float = 0.001  # of a view with a greater one: a stone of 2 mm before an aperture


@dataclass(frozen=True, slots=True)
class _Refusal:
    """Why the network gives no silhouette, and whether that is trouble of its own."""

    reason: str
    network_trouble: str | None = None


AS_GREY = "in places as grey as the wall behind it"
"""Doubt about a body some of which looked like wall but for its detail."""
NOISE_PER_BLOCK = 2 / 3
"""Error of a block of wall that noise explains, relative to a pixel's: two standard deviations of a mean of nine."""
WARM_UP_BLUR_PX = 3.0
"""Blur of the second image of the warm-up: its edge is placed another way."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChoosingSegmenter:
    """The `Segmenter` that asks one of two, view by view.

    Without a `network`, `no_network` says why, and so does every silhouette for which one would be asked.
    """

    classical: BackgroundSegmenter
    network: Segmenter | None
    no_network: str = "no model"
    wanted: SegmenterKind = "auto"
    parameters: ChoiceParameters = ChoiceParameters()

    def __call__(self, frame: Frame, background: BackgroundModel) -> Silhouette:
        """Return the better silhouette of the two; `fallback` says why it is not by the segmenter asked first."""
        if self.wanted == "onnx":
            return self._ask_network_first(frame, background)
        found, compared = self.classical.segment(frame, background)
        doubt = self._find_doubt(frame, background, found, compared)
        unseen = unseen_share(found) if doubt is None and self.wanted == "auto" else 0.0
        is_occluded = unseen > self.parameters.max_unseen_share
        if is_occluded:
            doubt = f"{unseen:.0%} of the outline unseen"
        if doubt is None:
            lacks_network = self.network is None and self.wanted == "auto"
            return replace(found, fallback=self.no_network) if lacks_network else found
        by_network = self._ask_network(frame, background)
        if isinstance(by_network, _Refusal):
            refusal = by_network.reason
        elif not by_network.is_usable and found.status is not ViewStatus.NO_BACKGROUND:
            refusal = f"network: {by_network.status}"
        elif is_occluded and unresolved_share(by_network) >= unresolved_share(found):
            refusal = "the network sees no more"
        else:
            return replace(by_network, fallback="; ".join(filter(None, (doubt, by_network.fallback))))
        return replace(found, fallback=f"{doubt}; {refusal}", network_trouble=by_network.network_trouble)

    def _ask_network_first(self, frame: Frame, background: BackgroundModel) -> Silhouette:
        by_network = self._ask_network(frame, background)
        if isinstance(by_network, _Refusal):
            found = self.classical(frame, background)
            return replace(found, fallback=by_network.reason, network_trouble=by_network.network_trouble)
        if by_network.is_usable:
            return by_network
        found = self.classical(frame, background)
        if not found.is_usable:
            return by_network
        reason = f"network: {by_network.status}"
        return replace(found, fallback=reason, network_trouble=by_network.network_trouble)

    def _ask_network(self, frame: Frame, background: BackgroundModel) -> Silhouette | _Refusal:
        """Return the network's silhouette, or why there is none."""
        if self.network is None:
            return _Refusal(self.no_network)
        try:
            return self.network(frame, background)
        except ModelError as err:
            return _Refusal(str(err), network_trouble=str(err))

    def _find_doubt(
        self, frame: Frame, background: BackgroundModel, found: Silhouette, compared: ComparedView | None
    ) -> str | None:
        """Return the reason to distrust the comparison with the background, `None` if there is none."""
        if compared is None:
            return "no background yet"
        if self.wanted != "auto":
            return None
        known, p = background[frame.camera], self.parameters
        if found.is_usable:
            hides = found.is_camouflaged and len(found.outline_uv) < len(found.reach_uv)
            return _outline_doubt(found, compared, known, p) or (AS_GREY if hides else None)
        view = _block_view(compared, known)
        doubt = _light_doubt(view, p)
        if doubt is None and found.status is ViewStatus.EMPTY:
            return _dark_doubt(view, known.typical * compared.gain, p)
        return doubt


def warm_up() -> None:
    """Compile what views of clean rigs need, sharp and blurred, by segmenting a made-up one: it takes seconds."""
    camera = CameraId("warm-up")
    image = np.full((8 * MARGIN_PX,) * 2, 200, np.uint8)
    image[3 * MARGIN_PX : 5 * MARGIN_PX, 3 * MARGIN_PX : 5 * MARGIN_PX] = 60
    empty = {camera: CameraBackground(mean=np.full(image.shape, 200, np.float32), n_frames=1)}
    for shown in (np.asarray(cv2.GaussianBlur(image, (0, 0), WARM_UP_BLUR_PX), np.uint8), image):
        frame = Frame(camera=camera, image=shown, frame_id=0, device_ns=0, received_ns=0)
        silhouette = ChoosingSegmenter(classical=BackgroundSegmenter(), network=None)(frame, empty)
        _ = silhouette.fine_px
    observe_optics(frame, empty, silhouette)


def unseen_share(found: Silhouette) -> float:
    """Return the share of the outline that was not seen, 0..1."""
    return _unseen_share(found.outline_uv)


@compiled
def _unseen_share(outline_uv: PointsUV) -> float:
    unseen_px, total_px = 0.0, 1e-9
    for i in range(len(outline_uv)):
        du, dv = outline_uv[i, 0] - outline_uv[i - 1, 0], outline_uv[i, 1] - outline_uv[i - 1, 1]
        step_px = np.sqrt(du * du + dv * dv)
        total_px += step_px
        unseen_px += step_px if step_px > MAX_STEP_PX else 0.0
    return unseen_px / total_px


def unresolved_share(found: Silhouette) -> float:
    """Return the unresolved share, 0..2: of the outline, plus that of the pixels that may be body."""
    may_be_body = int(np.count_nonzero(found.labels != OUTSIDE))
    unknown = np.count_nonzero(found.labels == UNKNOWN) / max(may_be_body, 1)
    return unseen_share(found) + unknown


class _BlockView(NamedTuple):
    """A view beside the empty rig in its light; arrays (h, w) of blocks."""

    seen: GreyImage
    empty: GreyImage
    is_wall: GreyImage  # 1 where the empty rig shows the plain wall


def _block_view(compared: ComparedView, known: CameraBackground) -> _BlockView:
    empty = np.asarray(cv2.convertScaleAbs(compared.levels, alpha=compared.gain), np.uint8)
    is_wall = known.coarse >= np.float32(PLAIN * known.typical)
    return _BlockView(seen=compared.seen, empty=empty, is_wall=is_wall.view(np.uint8))


def _light_doubt(view: _BlockView, parameters: ChoiceParameters) -> str | None:
    """Return a doubt if anything but bodies of good contrast differs from the wall of the empty rig."""
    seen, empty, is_wall = (
        _reduced(levels) for levels in (view.seen, view.empty * view.is_wall, 255 * view.is_wall)
    )
    clear = _dilated(_differs(seen, empty, parameters.clear_contrast))
    is_doubtful = (is_wall == 255) & (_differs(seen, empty, parameters.max_light_error) > clear)
    share = float(np.mean(is_doubtful))
    return f"light differs over {share:.1%} of the view" if share > parameters.max_doubtful_share else None


def _dark_doubt(view: _BlockView, wall: float, parameters: ChoiceParameters) -> str | None:
    """Return a doubt if anything may be before an aperture, where a body differs less than before the wall."""
    seen, empty, beside_wall = (
        _reduced(levels) for levels in (view.seen, view.empty, 255 * _dilated(view.is_wall))
    )
    is_other = (beside_wall == 0) & (cv2.absdiff(seen, empty) > parameters.max_dark_error * wall)
    share = float(np.mean(is_other))
    return f"{share:.1%} of the view differs, where it is dark" if share > parameters.max_dark_share else None


def _reduced(view: GreyImage) -> GreyImage:
    """Return the means of a view (h, w) over squares of `FRAME_BLOCKS`."""
    height, width = view.shape
    size = (max(width // FRAME_BLOCKS, 1), max(height // FRAME_BLOCKS, 1))
    return np.asarray(cv2.resize(view, size, interpolation=cv2.INTER_AREA), np.uint8)


def _outline_doubt(
    found: Silhouette, compared: ComparedView, known: CameraBackground, parameters: ChoiceParameters
) -> str | None:
    """Return a doubt if the wall beside the body is not what it was, or the body hardly differs from it."""
    images = BandImages(
        seen=compared.seen,
        expected=compared.levels,
        gain=np.float32(compared.gain),
        empty_rig=known.coarse_levels,
        min_wall_grey=np.uint8(ceil(PLAIN * known.typical)),
    )
    p = parameters
    max_error = p.max_light_error + NOISE_PER_BLOCK * max(compared.noise - QUIET_GREY, 0.0) / known.typical
    differing, faint = band_shares(found.labels, found.offset_uv, images, max_error, p.clear_contrast)
    if differing > p.max_dim_share:
        return f"light differs over {differing:.0%} around the body"
    return f"{faint:.0%} of the edge without contrast" if faint > p.max_faint_share else None


def _differs(seen: GreyImage, empty: GreyImage, share: float) -> GreyImage:
    """Return 1 where two views (h, w) differ by more than a share of the second."""
    return (cv2.absdiff(seen, empty) > cv2.convertScaleAbs(empty, alpha=share)).view(np.uint8)


def _dilated(mask: GreyImage) -> GreyImage:
    """Return the mask (h, w) dilated by one block on each side."""
    return np.asarray(cv2.dilate(mask, np.ones((3, 3), np.uint8)), np.uint8)
