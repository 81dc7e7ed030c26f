"""Tell the stone of a trigger from others in the same picture, by when each of them passed the light gate.

Free fall says how far above or below the stone that is due each other one is (`Fall.height_above_mm`). What differs
from the empty rig in a view is in connected parts; each belongs to the stone whose predicted place is nearest. Stones
whose silhouettes do not touch are told apart by that, however near; what belongs to others is then painted over with
the empty rig. In a view where another stone should be in the picture, but no part is its own, the two may touch or
cover each other: such a view shows several bodies.

How far a prediction is off (`SLACK_MM` allows for the sum):

- the centre of a stone lies half of its vertical extent above its lowest point, within 0.08 of that extent (rendered
  stones of all forms): for two stones of 15 mm 1.7 mm at most;
- 5 mm more or less from the start to the gate change the speed at the centre by 0.8 %: 0.4 mm of 50 mm;
- drag lets stones of 4 and 40 mm fall 1.0 mm differently in 0.3 m (`pipeline.fall`).

That is enough wherever stones reach: parts of two that cover each other are one part, within which the other one's
predicted centre lies, or it leads out of the picture, and no cut part is measured.

Where stones are from the axis of the fall is not predicted but measured in the views that show them alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil

import cv2
import numpy as np

from pipeline.arrays import Floats, Indices, Mask, PointsUV, Values, Vector
from pipeline.fall import Fall, vertical_extent_mm
from pipeline.frames import CameraId, Frame, FrameBundle, Trigger
from pipeline.rig.camera_arrays import nearest_point
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.segmentation import Segmenter, Silhouette, ViewStatus
from pipeline.segmentation.background import COARSE, BackgroundModel
from pipeline.segmentation.delineation import no_body
from pipeline.segmentation.subtraction import SegmentationParameters
from pipeline.segmentation.view_parts import ViewParts, painted_over, view_parts
from pipeline.view_mapper import ViewMapper

EXTENTS_MM = (3.0, 45.0)
"""Vertical extents that are believed of a gate; a longer pulse is that of several stones, or the gate is dirty."""
USUAL_EXTENT_MM = 20.0
"""Where the gate does not say."""
REACH = 0.75
"""Distance from its centre, as a share of its extent, in which one without a part of its own is looked for."""
CORE = 0.6
"""Share of the extent within which a part around the predicted centre is the due stone's, never another's."""
SLACK_MM = 5.0
"""Error of a predicted place; of one that was measured, `MEASURED_SLACK_MM`."""
MEASURED_SLACK_MM = 1.5
MAX_SHIFT_MM = 15.0
"""How far from the rig's centre the stone that is due may be."""
FAR_MM = 15.0
"""Distance of a part from a predicted place from which on it makes no difference."""
MIN_ALONE = 3
"""Views with one uncut part of a stone from which its place is measured."""
GAP_MM, PAINTED_MM = 1.0, 0.7
"""Least distance of two stones in a view, and how far around another one is painted over: its blurred rim."""
MIN_GAP_BLOCKS = 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PredictedStone:
    """Where a stone is predicted to be at the exposure."""

    center_mm: Vector
    extent_mm: float  # vertical, at the gate
    slack_mm: float = SLACK_MM

    @property
    def reach_mm(self) -> float:
        """Distance from the predicted centre within which some of the stone is."""
        return REACH * self.extent_mm + self.slack_mm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SingledOut:
    """Frames that show one stone, and the views in which it cannot be told from others."""

    frames: Mapping[CameraId, Frame]
    covered: frozenset[CameraId] = frozenset()
    painted: frozenset[CameraId] = frozenset()

    def segmenter(self, segmenter: Segmenter) -> Segmenter:
        """Return the segmenter that finds several bodies in the covered views."""

        def segment(frame: Frame, background: BackgroundModel) -> Silhouette:
            if frame.camera in self.covered:
                return no_body(frame, ViewStatus.MULTIPLE)
            return segmenter(frame, background)

        return segment if self.covered else segmenter


def predicted_places(trigger: Trigger, fall: Fall) -> list[PredictedStone]:
    """Return the places of the stone that is due, at the rig's centre, and of those near in time, in their order."""

    def extent_mm(width_ns: int | None) -> float:
        if width_ns is None:
            return USUAL_EXTENT_MM
        return float(np.clip(vertical_extent_mm(width_ns, fall.speed_at_gate_mm_s), *EXTENTS_MM))

    due_mm = extent_mm(trigger.pulse_width_ns)
    places = [PredictedStone(center_mm=np.zeros(3), extent_mm=due_mm)]
    for stone in trigger.near_stones:
        own_mm = extent_mm(stone.pulse_width_ns)
        above_mm = fall.height_above_mm(stone.later_ns) + (own_mm - due_mm) / 2
        places.append(PredictedStone(center_mm=np.array([0.0, 0.0, above_mm]), extent_mm=own_mm))
    return places


def single_out(
    bundle: FrameBundle,
    rig: RigCalibration,
    background: BackgroundModel,
    parameters: SegmentationParameters,
    fall: Fall,
    view_mapper: ViewMapper = map,
) -> SingledOut:
    """Return the bundle's frames with the stones of other triggers painted over.

    The very frames of the bundle if no other stone is near, or none of them can be in a picture.
    """
    frames = bundle.frames
    cameras = [camera for camera in rig.cameras if camera.id in frames]
    places = predicted_places(bundle.trigger, fall)
    seen = [place for place in places[1:] if any(_may_be_in_picture(place, camera) for camera in cameras)]
    if not seen:
        return SingledOut(frames=frames)
    found = view_mapper(
        lambda camera: view_parts(frames[camera.id], background.get(camera.id), parameters), cameras
    )
    views = {
        camera.id: CameraParts(camera=camera, parts=parts)
        for camera, parts in zip(cameras, found, strict=True)
        if parts is not None
    }
    told = tell_apart(list(views.values()), [places[0], *seen])

    def painted(camera: CameraId) -> Frame:
        frame, known, others = frames[camera], background.get(camera), told.others.get(camera)
        compared = views[camera].parts.compared if camera in views else None
        if known is None or compared is None or others is None:
            return frame
        return painted_over(frame, known, compared, others)

    return SingledOut(
        frames=dict(zip(frames, view_mapper(painted, frames), strict=True)),
        covered=told.covered,
        painted=frozenset(told.others),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraParts:
    """What one calibrated camera sees."""

    camera: CameraCalibration
    parts: ViewParts

    def along_mm(self, center_mm: Vector) -> tuple[Values, float, float]:
        """Return the heights (N,) of the parts above a point, and those of the view's lower and upper borders, in mm.

        All are on the vertical line through the point.
        """
        at_uv, per_mm = self._vertical(center_mm)
        along_mm = (self.parts.centers_uv - at_uv) @ per_mm / (per_mm @ per_mm)
        borders = np.array([0.0, self.camera.image_size_px[1] - 1.0])
        lower_mm, upper_mm = np.sort((borders - at_uv[1]) / per_mm[1])
        return along_mm, float(lower_mm), float(upper_mm)

    def _vertical(self, center_mm: Vector) -> tuple[Values, Values]:
        """Return the pixel (2,) of a point, and by how much (2,) it moves for each mm upwards."""
        (below, at, above), _ = self.camera.project(center_mm + np.outer([-0.5, 0.0, 0.5], [0.0, 0.0, 1.0]))
        return at, above - below

    def disc(self, center_mm: Vector) -> tuple[PointsUV, float]:
        """Return the pixel (2,) of a point, and the pixels of a mm there."""
        (at,), (depth_mm,) = self.camera.project(center_mm[None])
        return at, self.camera.focal_px / float(depth_mm)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToldApart:
    """What the views show of the stone that is due and of others."""

    places: Sequence[PredictedStone]  # measured where views allow, the due stone's first
    covered: frozenset[CameraId]  # views in which the due stone may touch or cover another one
    others: Mapping[CameraId, Mask] = field(default_factory=dict)  # blocks (H/4, W/4) of other stones


def tell_apart(views: Sequence[CameraParts], places: Sequence[PredictedStone]) -> ToldApart:
    """Give each part of each view to the due stone, the first of the places, or to one of the others."""
    shift_mm = np.array([0.0, 0.0, _common_shift_mm(views, places)])
    places = [replace(place, center_mm=place.center_mm + shift_mm) for place in places]
    for _ in range(2):
        owners = [_owners(view, places) for view in views]
        places = [_measured(views, owners, number, place) for number, place in enumerate(places)]
    covered, others = set(), {}
    for view in views:
        owned = _owners(view, places)
        if _may_cover(view, owned, places):
            covered.add(view.camera.id)
        elif (owned > 0).any():
            gap = _gap_blocks(view, places[0], PAINTED_MM)
            others[view.camera.id] = _around(_blocks(view, owned > 0), gap)
    return ToldApart(places=places, covered=frozenset(covered), others=others)


def _common_shift_mm(views: Sequence[CameraParts], places: Sequence[PredictedStone]) -> float:
    """Return the height at which the due stone, with all others at their distances from it, explains most parts."""
    shifts_mm = np.linspace(-MAX_SHIFT_MM, MAX_SHIFT_MM, 61)
    cost = 0.01 * np.abs(shifts_mm)
    for view in views:
        if not len(view.parts.centers_uv):
            continue
        off_mm = np.minimum(_off_mm(view, places, shifts_mm), FAR_MM)
        cost += off_mm.min(axis=0).sum(axis=0) + off_mm[0].min(axis=0)
    return float(shifts_mm[np.argmin(cost)])


def _off_mm(view: CameraParts, places: Sequence[PredictedStone], shifts_mm: Values) -> Floats:
    """Return the distances, mm, of each part from the middle of a stone as the picture cuts it (places, N, shifts)."""
    off = []
    for place in places:
        along_mm, lower_mm, upper_mm = view.along_mm(place.center_mm)
        half_mm = place.extent_mm / 2
        ends_mm = np.clip(
            [shifts_mm - half_mm, shifts_mm + half_mm], lower_mm, upper_mm
        )  # of what is within the picture
        off.append(np.abs(along_mm[:, None] - ends_mm.mean(axis=0)))
    return np.array(off)


def _owners(view: CameraParts, places: Sequence[PredictedStone]) -> Indices:
    """Return the place that each part (N,) belongs to."""
    if not len(view.parts.centers_uv):
        return np.zeros(0, np.int64)
    owners = _off_mm(view, places, np.zeros(1))[:, :, 0].argmin(axis=0)
    at, px_per_mm = view.disc(places[0].center_mm)
    core_px = CORE * places[0].extent_mm * px_per_mm
    owners[np.linalg.norm(view.parts.centers_uv - at, axis=1) < core_px] = 0
    return owners


def _measured(
    views: Sequence[CameraParts], owners: Sequence[Indices], number: int, place: PredictedStone
) -> PredictedStone:
    """Return a place as the views have it that show the stone in one uncut part; as it was if too few do."""
    origins, rays = [], []
    for view, owned in zip(views, owners, strict=True):
        own = np.flatnonzero(owned == number)
        if len(own) == 1 and not view.parts.is_cut[own[0]]:
            origins.append(view.camera.center_mm)
            rays.append(view.camera.rays(view.parts.centers_uv[own])[0])
    if len(rays) < MIN_ALONE:
        return place
    center_mm = nearest_point(np.array(origins), np.array(rays))
    if np.linalg.norm(center_mm - place.center_mm) > FAR_MM:
        return place
    return replace(place, center_mm=center_mm, slack_mm=MEASURED_SLACK_MM)


def _may_cover(view: CameraParts, owned: Indices, places: Sequence[PredictedStone]) -> bool:
    """True when the due stone may touch or cover another one in a view."""
    if not len(owned):
        return False
    if not (owned == 0).any():
        return True  # all that is seen is nearer to another
    parts, due = view.parts, _blocks(view, owned == 0)
    others = _blocks(view, owned > 0)
    joined = np.intersect1d(parts.joined[due], parts.joined[others])
    if len(joined) or (_around(others, _gap_blocks(view, places[0], GAP_MM)) & due).any():
        return True
    rows, columns = np.nonzero(due)
    due_uv = COARSE * np.column_stack([columns, rows]) + (COARSE - 1) / 2
    for number, place in enumerate(places[1:], start=1):
        if (owned == number).any() or not _may_be_in_picture(place, view.camera):
            continue
        at, px_per_mm = view.disc(place.center_mm)
        if np.linalg.norm(due_uv - at, axis=1).min() < place.reach_mm * px_per_mm:
            return True
    return False


def _may_be_in_picture(place: PredictedStone, camera: CameraCalibration) -> bool:
    """True when some of a stone may be in the picture of a camera."""
    (at,), (depth_mm,) = camera.project(place.center_mm[None])
    last = np.array(camera.image_size_px) - 1
    beyond_px = float(np.linalg.norm(at - np.clip(at, 0, last)))
    return beyond_px < place.reach_mm * camera.focal_px / float(depth_mm)


def _blocks(view: CameraParts, chosen: Mask) -> Mask:
    """Return the blocks (H/4, W/4) of the chosen parts (N,)."""
    return np.concatenate([[False], chosen])[view.parts.numbers]


def _gap_blocks(view: CameraParts, place: PredictedStone, gap_mm: float) -> int:
    return max(MIN_GAP_BLOCKS, ceil(gap_mm * view.disc(place.center_mm)[1] / COARSE))


def _around(blocks: Mask, n: int) -> Mask:
    """Return the blocks (H/4, W/4) up to `n` away from some."""
    return cv2.dilate(blocks.view(np.uint8), np.ones((2 * n + 1,) * 2, np.uint8)).view(np.bool_)
