"""Which segmenter a view is given to.

Comparing with the empty rig is quick and unbiased as long as the wall around the body looks as it did
without it, and body and wall differ. Where that does not hold the network is asked. Each takes the
other's place where it finds nothing, and the silhouette says which of them it is from, and why.
"""

from dataclasses import dataclass, replace
from math import ceil
from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.errors import ModelError
from pipeline.frames import CameraId, Frame
from pipeline.segmentation import Segmenter
from pipeline.segmentation.background import BackgroundModel, CameraBackground
from pipeline.segmentation.optics import observe_optics
from pipeline.segmentation.outline_bands import Views, shares_beside
from pipeline.segmentation.silhouette import MARGIN_PX, MAX_STEP_PX, OUTSIDE, UNKNOWN, Silhouette, ViewStatus
from pipeline.segmentation.subtraction import BackgroundSegmenter, EmptyView

Grey = NDArray[np.uint8]

Wanted = Literal["auto", "background", "onnx"]
"""The segmenter that is asked first; `auto`: the background's, and the network where its ground is not sound."""

FRAME_BLOCKS = 4
"""A view without a silhouette is looked at in blocks of this edge, in blocks of 4 px."""
PLAIN = 0.75
"""What is darker than this share of the wall is a screw, a vent or an aperture, or their blurred border."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChoiceParameters:
    """When the ground of background segmentation is not sound."""

    max_light_error: float = 0.03  # of the wall beside the body; moves an edge of 2 px width by 0.05 px
    max_dim_share: float = 0.1  # of that wall with a greater error: the first sign of a slope or a shadow
    clear_contrast: float = 0.35  # of a body to the wall; dull stones have 0.4 and more
    max_faint_share: float = 0.06  # of the rim of a body with less; 5 mm across a screw have a twentieth
    max_unseen_share: float = 0.12  # of the outline; a screw hides 0.07 of that of a stone of 15 mm
    max_doubtful_share: float = 0.002  # of a view neither wall nor clearly different: a body of 4 mm
    max_dark_error: float = 0.02  # of the wall, where it is dark: four times what noise does to a block
    max_dark_share: float = 0.001  # of a view with a greater one: a stone of 2 mm before an aperture


@dataclass(frozen=True, slots=True, kw_only=True)
class ChoosingSegmenter:
    """The `Segmenter` that asks one of two, view by view.

    Without a `network`, `no_network` says why, and so does every silhouette for which one is wanted.
    """

    classical: BackgroundSegmenter
    network: Segmenter | None
    no_network: str = "no model"
    wanted: Wanted = "auto"
    parameters: ChoiceParameters = ChoiceParameters()

    def __call__(self, frame: Frame, background: BackgroundModel) -> Silhouette:
        """The silhouette by the better of the two; its `fallback` says why it is not by the one asked first."""
        if self.wanted == "onnx":
            return self._rather_by_network(frame, background)
        found, empty = self.classical.compared(frame, background)
        doubt = self._doubt(frame, background, found, empty)
        unseen = unseen_share(found) if doubt is None and self.wanted == "auto" else 0.0
        is_hidden = unseen > self.parameters.max_unseen_share
        if is_hidden:
            doubt = f"{unseen:.0%} of the outline unseen"
        if doubt is None:
            is_missed = self.network is None and self.wanted == "auto"
            return replace(found, fallback=self.no_network) if is_missed else found
        other = self._by_network(frame, background)
        if isinstance(other, str):
            refusal = other
        elif not other.is_usable and found.status is not ViewStatus.NO_BACKGROUND:
            refusal = f"network: {other.status}"
        elif is_hidden and hidden_share(other) >= hidden_share(found):
            refusal = "the network sees no more"
        else:
            return replace(other, fallback="; ".join(filter(None, (doubt, other.fallback))))
        return replace(found, fallback=f"{doubt}; {refusal}")

    def _rather_by_network(self, frame: Frame, background: BackgroundModel) -> Silhouette:
        found = self._by_network(frame, background)
        if isinstance(found, str):
            return replace(self.classical(frame, background), fallback=found)
        if found.is_usable:
            return found
        other = self.classical(frame, background)
        return replace(other, fallback=f"network: {found.status}") if other.is_usable else found

    def _by_network(self, frame: Frame, background: BackgroundModel) -> Silhouette | str:
        """What the network finds, or why it cannot be asked."""
        if self.network is None:
            return self.no_network
        try:
            return self.network(frame, background)
        except ModelError as err:
            return str(err)

    def _doubt(
        self, frame: Frame, background: BackgroundModel, found: Silhouette, empty: EmptyView | None
    ) -> str | None:
        """Why what the comparison with the background found is not to be trusted."""
        if empty is None:
            return "no background yet"
        if self.wanted != "auto":
            return None
        known, p = background[frame.camera], self.parameters
        if found.is_usable:
            return _doubt_of_light(found, empty, known, p)
        view = _beside(empty, known)
        doubt = _doubt_of_view(view, p)
        if doubt is None and found.status is ViewStatus.EMPTY:
            return _doubt_of_dark(view, known.typical * empty.gain, p)
        return doubt


def warm_up() -> None:
    """Compile what views of clean rigs need, by looking at one made up for it: seconds that the first stone has not."""
    camera = CameraId("warm-up")
    image = np.full((8 * MARGIN_PX,) * 2, 200, np.uint8)
    image[3 * MARGIN_PX : 5 * MARGIN_PX, 3 * MARGIN_PX : 5 * MARGIN_PX] = 60
    empty = {camera: CameraBackground(mean=np.full(image.shape, 200, np.float32), n_frames=1)}
    frame = Frame(camera=camera, image=image, frame_id=0, device_ns=0, received_ns=0)
    silhouette = ChoosingSegmenter(classical=BackgroundSegmenter(), network=None)(frame, empty)
    _ = silhouette.fine_px
    observe_optics(frame, empty, silhouette)


def unseen_share(found: Silhouette) -> float:
    """Share of the outline that was not seen, 0..1."""
    return _unseen_share(found.outline_uv)


@compiled
def _unseen_share(outline_uv: NDArray[np.float64]) -> float:
    unseen_px, total_px = 0.0, 1e-9
    for i in range(len(outline_uv)):
        du, dv = outline_uv[i, 0] - outline_uv[i - 1, 0], outline_uv[i, 1] - outline_uv[i - 1, 1]
        step_px = np.sqrt(du * du + dv * dv)
        total_px += step_px
        unseen_px += step_px if step_px > MAX_STEP_PX else 0.0
    return unseen_px / total_px


def hidden_share(found: Silhouette) -> float:
    """How much is not known: of the outline, and of what may be body; 0..2."""
    may_be_body = int(np.count_nonzero(found.labels != OUTSIDE))
    unknown = np.count_nonzero(found.labels == UNKNOWN) / max(may_be_body, 1)
    return unseen_share(found) + unknown


class _Beside(NamedTuple):
    """What is seen of a view, beside the empty rig; arrays (h, w) of blocks."""

    seen: Grey
    empty: Grey
    is_wall: Grey  # 1 where that is the plain wall


def _beside(empty: EmptyView, known: CameraBackground) -> _Beside:
    expected = np.asarray(cv2.convertScaleAbs(empty.levels, alpha=empty.gain), np.uint8)
    is_wall = known.coarse >= np.float32(PLAIN * known.typical)
    return _Beside(seen=empty.seen, empty=expected, is_wall=is_wall.view(np.uint8))


def _doubt_of_view(view: _Beside, parameters: ChoiceParameters) -> str | None:
    """Whether anything but bodies of good contrast differs from the wall of the empty rig."""
    seen, empty, is_wall = (
        _reduced(each) for each in (view.seen, view.empty * view.is_wall, 255 * view.is_wall)
    )
    clear = _grown(_differs(seen, empty, parameters.clear_contrast), 1)
    is_doubtful = (is_wall == 255) & (_differs(seen, empty, parameters.max_light_error) > clear)
    share = float(np.mean(is_doubtful))
    return f"light differs over {share:.1%} of the view" if share > parameters.max_doubtful_share else None


def _doubt_of_dark(view: _Beside, wall: float, parameters: ChoiceParameters) -> str | None:
    """Whether anything is before an aperture, where a body is not told by as much as before the wall."""
    seen, empty, beside_wall = (
        _reduced(each) for each in (view.seen, view.empty, 255 * _grown(view.is_wall, 1))
    )
    is_other = (beside_wall == 0) & (cv2.absdiff(seen, empty) > parameters.max_dark_error * wall)
    share = float(np.mean(is_other))
    return f"{share:.1%} of the view differs, where it is dark" if share > parameters.max_dark_share else None


def _reduced(view: Grey) -> Grey:
    """Means over `FRAME_BLOCKS` of a view (h, w)."""
    height, width = view.shape
    size = (max(width // FRAME_BLOCKS, 1), max(height // FRAME_BLOCKS, 1))
    return np.asarray(cv2.resize(view, size, interpolation=cv2.INTER_AREA), np.uint8)


def _doubt_of_light(
    found: Silhouette, empty: EmptyView, known: CameraBackground, parameters: ChoiceParameters
) -> str | None:
    """Whether the wall beside the body is what it was, and the body differs from it."""
    views = Views(
        seen=empty.seen,
        empty=empty.levels,
        gain=np.float32(empty.gain),
        clean=known.coarse_levels,
        least=np.uint8(ceil(PLAIN * known.typical)),
    )
    p = parameters
    differing, faint = shares_beside(
        found.labels, found.offset_uv, views, p.max_light_error, p.clear_contrast
    )
    if differing > p.max_dim_share:
        return f"light differs over {differing:.0%} around the body"
    return f"{faint:.0%} of the edge without contrast" if faint > p.max_faint_share else None


def _differs(seen: Grey, empty: Grey, share: float) -> Grey:
    """1 where two views (h, w) differ by more than a share of the second."""
    return (cv2.absdiff(seen, empty) > cv2.convertScaleAbs(empty, alpha=share)).view(np.uint8)


def _grown(mask: Grey, blocks: int) -> Grey:
    """The mask (h, w) wider by so many blocks on each side, narrower if negative."""
    square = np.ones((2 * abs(blocks) + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(mask, square) if blocks > 0 else cv2.erode(mask, square), np.uint8)
