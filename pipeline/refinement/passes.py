"""The passes over the surface, from coarse to fine, and what counts as evidence."""

from dataclasses import dataclass
from math import ceil

import numpy as np

from pipeline.arrays import Values

OUTWARD_MM, DEEPEST_SHARE = 0.15, 0.17
"""Greatest shift outward that is tried, and inward, as a share of the stone's size: most dents are 0.15 of it deep."""
N_SAMPLES, MAX_VIEWS = 5, 3
"""Samples along the edge of a patch, and views that are compared: four samples find depths by chance on even faces."""
STIFFNESS = 0.035
"""Cost of a millimetre between neighbours a millimetre apart."""
SPIKE_SLOPE = 0.4
"""Distance of a node from the median of its neighbours, per spacing, that is believed at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pass:
    """One pass; lengths are those of a stone of `FULL_SIZE_MM` or more."""

    spacing_mm: float  # of nodes
    half_mm: float  # of the edge of a patch
    inward_mm: float  # limit of the depths that are tried, relative to the pass before
    step_mm: float  # of depths at most
    scale: float = 0.5  # of the images, 0.5 or 1
    even_score: float = 0.0  # of patches without texture: alike, as far as one can tell

    def depths_mm(self, size_mm: float) -> Values:
        """Return the depths (L,) that are tried on a stone of this size, L a multiple of 8: computed side by side."""
        least_mm, most_mm = -OUTWARD_MM, min(self.inward_mm, DEEPEST_SHARE * size_mm)
        return np.linspace(least_mm, most_mm, 8 * ceil(((most_mm - least_mm) / self.step_mm + 1) / 8))


PASSES = (
    Pass(spacing_mm=0.8, half_mm=0.6, inward_mm=6.0, step_mm=0.2),
    Pass(spacing_mm=0.6, half_mm=0.45, inward_mm=1.0, step_mm=0.06),
    Pass(spacing_mm=0.32, half_mm=0.35, inward_mm=0.11, step_mm=0.04, scale=1.0),
)
"""Patches of the last pass are as large as noise wants them, those of the others as small as it lets them be."""
SEARCHED_AGAIN = Pass(spacing_mm=0.32, half_mm=0.27, inward_mm=1.8, step_mm=0.09, even_score=1.0)
"""Wide once more at the last pass's nodes, but only where patches look unlike."""
UNLIKE, UNLIKE_RINGS = 0.75, 1
"""Score relative to that of most nodes below which a node is searched again, and the rings of neighbours with it."""
AGAIN_ROUNDS = 2
"""Rounds of searching again: a third gains 7 % of what is lost, in 5 % more time."""
ALIKE_SHARE = 0.65
"""Score, relative to that of most nodes, from which patches count as alike in the end."""
FULL_SIZE_MM = 13.0
"""Cube root of the volume from which lengths are those of the passes; those of smaller stones shrink with it."""
LEAST_SCALE = 0.75
NORMAL_ROUNDS = 2
"""Smoothing of the normals along which the surface is shifted: of half a millimetre around."""
NOISE_LEFT = {0.5: 0.08, 1.0: 0.45}
"""Share of a pixel's variance left in images at half their size, and between the pixels of those at full size."""
UNLIKE_SHARE = 0.02
"""Share of its grey level by which two views show the same place differently, by their shading and interpolation."""
ALIKE = (0.4, 0.7)
"""Scores of no confidence and of full confidence."""
PEAKED = 0.02
"""Curvature of the score, per step of depth, from which a depth is told from its neighbours."""
EVIDENCE = 0.3
"""Mean confidence of a neighbourhood from which it is shifted at all; from twice that, fully."""
DOUBTFUL = 0.1
"""Weight of a node without confidence of its own amid others: it follows the propagation."""
OLDER, SURE = 0.6, 0.3
"""Weight of a shift that only the pass before the last one has evidence for, and its weight there from which it counts.

From twice that it counts fully. With all its weight, edges of cubes rise by 0.05 mm; without, black stones lose dents.
"""
TOUCH_MM = 0.3
"""Reach of a point where a tangent ray touches: there the silhouettes say where the surface is."""
PIN = 0.5
"""Cost of a millimetre away from such a point."""
RIDGE = (0.05, 0.12)
"""Sharpness of the body's convex edges from which flat patches begin to mislead, and from which they all do."""
