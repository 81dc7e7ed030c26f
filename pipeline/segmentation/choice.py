"""Which segmenter a view is given to.

Comparing with the empty rig is quick and unbiased as long as the wall around the body looks as it did
without it, and body and wall differ. Where that does not hold the network is asked. Each takes the
other's place where it finds nothing, and the silhouette says which of them it is from, and why.
"""

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ModelError
from pipeline.frames import Frame
from pipeline.segmentation import Segmenter
from pipeline.segmentation.background import COARSE, BackgroundModel
from pipeline.segmentation.silhouette import INSIDE, MAX_STEP_PX, OUTSIDE, UNKNOWN, Silhouette, ViewStatus
from pipeline.segmentation.subtraction import BackgroundSegmenter, EmptyView, sampled

Grey = NDArray[np.uint8]

Wanted = Literal["auto", "background", "onnx"]
"""The segmenter that is asked first; `auto`: the background's, and the network where its ground is not sound."""

RING_BLOCKS = (2, 8)
"""The surroundings of a body begin and end so many blocks of 4 px beside it: further out than motion blurs it,
and within the margin that a silhouette has."""
RIM_BLOCKS = (1, 3)
"""The rim of a body, likewise inwards: beyond the blur of the edge, and no further than its level is carried."""
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
        wall = np.where(known.coarse < np.float32(PLAIN * known.typical), np.uint8(0), empty.expected)
        seen = sampled(frame.image)
        if not found.is_usable:
            return _doubt_of_view(seen, wall, p)
        return _doubt_of_light(seen, wall, found, p)


def unseen_share(found: Silhouette) -> float:
    """Share of the outline that was not seen, 0..1."""
    steps_px = np.linalg.norm(found.outline_uv - np.roll(found.outline_uv, 1, axis=0), axis=1)
    return float(steps_px[steps_px > MAX_STEP_PX].sum() / max(steps_px.sum(), 1))


def hidden_share(found: Silhouette) -> float:
    """How much is not known: of the outline, and of what may be body; 0..2."""
    may_be_body = int(np.count_nonzero(found.labels != OUTSIDE))
    unknown = np.count_nonzero(found.labels == UNKNOWN) / max(may_be_body, 1)
    return unseen_share(found) + unknown


def _doubt_of_view(seen: Grey, empty: Grey, parameters: ChoiceParameters) -> str | None:
    """Whether anything but bodies of good contrast differs from the empty rig."""
    height, width = seen.shape
    blocks = (max(width // FRAME_BLOCKS, 1), max(height // FRAME_BLOCKS, 1))
    is_wall = (empty > 0).view(np.uint8)
    seen, empty, is_wall = (
        np.asarray(cv2.resize(each, blocks, interpolation=cv2.INTER_AREA), np.uint8)
        for each in (seen, empty, 255 * is_wall)
    )
    clear = _grown(_differs(seen, empty, parameters.clear_contrast), 1)
    is_doubtful = (is_wall == 255) & (_differs(seen, empty, parameters.max_light_error) > clear)
    share = float(np.mean(is_doubtful))
    return f"light differs over {share:.1%} of the view" if share > parameters.max_doubtful_share else None


def _doubt_of_light(seen: Grey, empty: Grey, found: Silhouette, parameters: ChoiceParameters) -> str | None:
    """Whether the wall beside the body is what it was, and the body differs from it."""
    (left, top), (height, width) = found.offset_uv, found.labels.shape
    rows = slice(-(-top // COARSE), (top + height) // COARSE)
    columns = slice(-(-left // COARSE), (left + width) // COARSE)
    first = (rows.start * COARSE + COARSE // 2 - top, columns.start * COARSE + COARSE // 2 - left)
    seen = np.asarray(cv2.blur(seen[rows, columns], (3, 3)), np.uint8)  # a third of the noise
    empty = empty[rows, columns]
    labels = found.labels[first[0] :: COARSE, first[1] :: COARSE][: len(empty), : empty.shape[1]]
    inside, covered = (labels == INSIDE).view(np.uint8), (labels != OUTSIDE).view(np.uint8)
    nearest, farthest = RING_BLOCKS
    ring = (empty > 0) & (_grown(inside, farthest) > _grown(covered, nearest))
    is_off = _differs(seen, empty, parameters.max_light_error)[ring]
    if is_off.size and is_off.mean() > parameters.max_dim_share:
        errors = np.abs(seen[ring] / empty[ring].astype(np.float32) - 1)
        return f"light differs by {np.quantile(errors, 0.9):.0%} around the body"
    shallow, deep = RIM_BLOCKS
    rim = (empty > 0) & (_grown(covered, -shallow) > _grown(inside, -deep))
    is_clear = _differs(seen, empty, parameters.clear_contrast)[rim]
    faint = 1 - float(is_clear.mean()) if is_clear.size else 0.0
    return f"{faint:.0%} of the edge without contrast" if faint > parameters.max_faint_share else None


def _differs(seen: Grey, empty: Grey, share: float) -> Grey:
    """1 where two views (h, w) differ by more than a share of the second."""
    return (cv2.absdiff(seen, empty) > cv2.convertScaleAbs(empty, alpha=share)).view(np.uint8)


def _grown(mask: Grey, blocks: int) -> Grey:
    """The mask (h, w) wider by so many blocks on each side, narrower if negative."""
    square = np.ones((2 * abs(blocks) + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(mask, square) if blocks > 0 else cv2.erode(mask, square), np.uint8)
