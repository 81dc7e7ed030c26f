"""Where patches of the surface look most alike: at all nodes of a level, then again where they still look unlike."""

from dataclasses import dataclass, fields, replace

import numpy as np

from pipeline.arrays import Directions, Flags, PointsMM, Singles, Values
from pipeline.refinement.node_field import depths_of, facing, tangent_axes, without_spikes
from pipeline.refinement.nodes import Nodes, of_nodes, widened
from pipeline.refinement.passes import (
    AGAIN_ROUNDS,
    ALIKE_SHARE,
    FULL_SIZE_MM,
    LEAST_SCALE,
    MAX_VIEWS,
    PIN,
    SEARCHED_AGAIN,
    SPIKE_SLOPE,
    STIFFNESS,
    UNLIKE,
    UNLIKE_RINGS,
    Pass,
)
from pipeline.refinement.patch_scores import Patches, patch_scores
from pipeline.refinement.propagation import propagate
from pipeline.refinement.sightings import PhotoViews, depth_maps, sightings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Photographed:
    """A stone as its views show it."""

    views: PhotoViews
    size_mm: float  # cube root of its volume

    @property
    def scale(self) -> float:
        """Lengths of a pass, relative to those on a large stone."""
        return float(np.clip(self.size_mm / FULL_SIZE_MM, LEAST_SCALE, 1.0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Level:
    """The nodes that a pass shifts, and what holds these to the estimate."""

    each: Pass
    nodes: Nodes
    gate: Values  # (K,) 1 where patches lie on one face, 0 at a sharp edge of the body
    touches: Values  # (K,) 1 where a tangent ray touches, 0 far from it

    @property
    def most_mm(self) -> float:
        """Distance of a node from the median of its neighbours that is believed."""
        return SPIKE_SLOPE * self.nodes.spacing_mm

    def points_mm(self, shifts_mm: Values) -> PointsMM:
        """Return where the nodes lie, once shifted inward (K,)."""
        return self.nodes.points_mm - shifts_mm[:, None] * self.nodes.normals

    def of(self, chosen: Flags, each: Pass) -> "Level":
        """Return a level of the chosen nodes (K,) alone, for another pass."""
        return Level(
            each=each,
            nodes=of_nodes(self.nodes, chosen),
            gate=self.gate[chosen],
            touches=self.touches[chosen],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """What was found at K nodes, beyond where they lay."""

    before_mm: Values  # inward, from the estimate's surface
    steps_mm: Values
    sure: Values
    is_peak: Flags
    scores: Values  # of the patches there

    @property
    def shifts_mm(self) -> Values:
        """Shifts of the nodes (K,): as before where there is no evidence."""
        return self.before_mm + np.where(self.sure > 0, self.steps_mm, 0.0)

    def with_better(self, other: "Found", chosen: Flags) -> tuple["Found", Flags]:
        """Return this with what was found better at the chosen nodes (K,), and flags of these (K,)."""
        better = other.scores > self.scores[chosen]
        is_better = np.zeros(len(chosen), np.bool_)
        is_better[np.flatnonzero(chosen)[better]] = True
        merged = replace(self, **{field.name: getattr(self, field.name).copy() for field in fields(self)})
        for field in fields(self):
            getattr(merged, field.name)[is_better] = getattr(other, field.name)[better]
        return merged, is_better


def search(level: Level, before_mm: Values, stone: Photographed, normals: Directions | None = None) -> Found:
    """Search all nodes of a level, which lie `before_mm` (K,) below the estimate; normals are those of this surface."""
    points_mm = level.points_mm(before_mm)
    maps = depth_maps(stone.views, points_mm)
    if normals is None:
        normals = facing(points_mm, level.nodes)
    return _search(level, before_mm, normals, maps, stone)


def search_again(level: Level, found: Found, stone: Photographed) -> tuple[Found, Flags, Flags]:
    """Search again, wide and then as finely as before, where patches look unlike.

    Return what is found now, and flags of nodes (K,): where patches look alike, and which of them are deeper now.

    Most of what was missed lies on the steep walls of dents: once the rest is found, it is known which views see it,
    and how it is slanted. So each round finds what the one before has laid open.
    """
    typical = float(np.median(found.scores[~level.nodes.at_edge]))
    start_mm, is_new = found.shifts_mm, np.zeros(len(found.scores), np.bool_)
    for _ in range(AGAIN_ROUNDS):
        found, is_better = _searched_again(level, found, UNLIKE * typical, stone)
        is_new |= is_better
    is_alike = found.scores > ALIKE_SHARE * typical
    return found, is_alike, is_new & is_alike & (found.shifts_mm > start_mm)


def _searched_again(
    level: Level, found: Found, least_score: float, stone: Photographed
) -> tuple[Found, Flags]:
    """Search again where scores are less; return what is found then, and flags of the nodes (K,) that are better."""
    nodes = level.nodes
    chosen = (found.scores < least_score) & ~nodes.at_edge
    for _ in range(UNLIKE_RINGS):
        chosen = widened(chosen, nodes)
    shifts_mm = without_spikes(found.shifts_mm, nodes, level.most_mm)
    for each in (SEARCHED_AGAIN, level.each):
        points_mm = level.points_mm(shifts_mm)
        normals, maps = facing(points_mm, nodes), depth_maps(stone.views, points_mm)
        again = _search(level.of(chosen, each), shifts_mm[chosen], normals[chosen], maps, stone)
        shifts_mm = shifts_mm.copy()
        shifts_mm[chosen] = again.before_mm + again.steps_mm
    return found.with_better(again, chosen)


def _search(
    level: Level, before_mm: Values, normals: Directions, maps: Singles, stone: Photographed
) -> Found:
    each, nodes = level.each, level.nodes
    half_mm, depths_mm = stone.scale * each.half_mm, each.depths_mm(stone.size_mm)
    points_mm = level.points_mm(before_mm)
    seen_by = sightings(stone.views, maps, points_mm, normals, half_mm, MAX_VIEWS)
    patches = Patches(points_mm, -nodes.normals, tangent_axes(normals), half_mm, *seen_by)
    scores = patch_scores(stone.views, patches, depths_mm, each)
    costs = level.gate[:, None] * (1 - scores)
    costs += PIN * level.touches[:, None] * np.abs(before_mm[:, None] + depths_mm)
    per_step = STIFFNESS / nodes.spacing_mm * float(depths_mm[1] - depths_mm[0])
    beliefs = propagate(costs.astype(np.float32), nodes.neighbours, per_step)
    steps_mm, sure, is_peak = depths_of(beliefs, scores, depths_mm, nodes, level.gate)
    likeness = scores[np.arange(len(beliefs)), beliefs.argmin(axis=1)]
    return Found(before_mm=before_mm, steps_mm=steps_mm, sure=sure, is_peak=is_peak, scores=likeness)
