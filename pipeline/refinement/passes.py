"""The passes over the surface, from coarse to fine, and what counts as evidence."""

from dataclasses import dataclass, replace
from math import ceil, inf

import numpy as np

from pipeline.arrays import Values


@dataclass(frozen=True, slots=True, kw_only=True)
class Pass:
    """One pass; lengths are those of a stone of `FULL_SIZE_MM` or more."""

    spacing_mm: float  # of nodes
    half_mm: float  # of the edge of a patch
    scale: float  # of the images, 0.5 or 1
    outward_mm: float  # limits of the depths that are tried, relative to the pass before
    inward_mm: float
    deepest_share: float  # limit of these as a share of the stone's size
    n_depths: int  # at least; a multiple of 8: they are computed side by side
    step_mm: float  # of depths at most: of large stones more are tried
    stiffness: float  # cost of a millimetre between neighbours a millimetre apart
    staying: float  # cost of a millimetre away from the estimate
    n_samples: int  # along an edge of a patch
    max_views: int
    pairs_share: float  # of the pairs of views, those most alike, that count
    even_score: float  # of patches without texture: alike, as far as one can tell
    spike_slope: (
        float  # distance of a node from the median of its neighbours, per spacing, that is believed at most
    )

    def depths_mm(self, size_mm: float) -> Values:
        """Return the depths (L,) that are tried on a stone of this size, L a multiple of 8."""
        least_mm = -min(self.outward_mm, self.deepest_share * size_mm)
        most_mm = min(self.inward_mm, self.deepest_share * size_mm)
        n_depths = 8 * ceil(((most_mm - least_mm) / self.step_mm + 1) / 8)
        return np.linspace(least_mm, most_mm, max(n_depths, self.n_depths))


COARSE = Pass(
    spacing_mm=0.8,
    half_mm=0.55,
    scale=0.5,
    outward_mm=0.17,
    inward_mm=6.0,
    deepest_share=0.17,  # most dents are 0.15 of the cube root of the volume deep
    n_depths=16,
    step_mm=0.2,
    stiffness=0.0525,
    staying=0.06,
    n_samples=5,
    max_views=4,
    pairs_share=0.5,
    even_score=0.0,
    spike_slope=inf,
)
MIDDLE = Pass(
    spacing_mm=0.6,
    half_mm=0.45,
    scale=0.5,
    outward_mm=0.2,
    inward_mm=1.0,
    deepest_share=0.13,
    n_depths=24,
    step_mm=inf,
    stiffness=0.028,
    staying=0.0,
    n_samples=5,
    max_views=4,
    pairs_share=1.0,
    even_score=0.5,
    spike_slope=0.4,
)
PASSES = (
    COARSE,
    MIDDLE,
    Pass(
        spacing_mm=0.36,
        half_mm=0.35,
        scale=1.0,
        outward_mm=0.11,
        inward_mm=0.11,
        deepest_share=0.065,
        n_depths=8,
        step_mm=inf,
        stiffness=0.028,
        staying=0.0,
        n_samples=5,
        max_views=3,
        pairs_share=1.0,
        even_score=0.0,
        spike_slope=0.4,
    ),
)
SEARCHED_AGAIN = replace(
    COARSE, spacing_mm=PASSES[-1].spacing_mm, half_mm=0.28, outward_mm=0.1, inward_mm=1.8, n_depths=24, step_mm=0.1,
    stiffness=0.04, staying=0.0, max_views=3, even_score=1.0,
)  # fmt: skip
"""Wide once more at the last pass's nodes, but only where patches look unlike."""
UNLIKE, UNLIKE_RINGS = 0.75, 1
"""Score relative to that of most nodes below which a node is searched again, and the rings of neighbours with it."""
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
OLDER, SURE = 0.5, 0.3
"""Weight of a shift that only the pass before the last one has evidence for, and its weight there from which it counts.

From twice that it counts fully.
"""
TOUCH_MM = 0.3
"""Reach of a point where a tangent ray touches: there the silhouettes say where the surface is."""
PIN = 0.5
"""Cost of a millimetre away from such a point."""
RIDGE = (0.05, 0.12)
"""Sharpness of the body's convex edges from which flat patches begin to mislead, and from which they all do."""
TRUNCATED_MM = 1.2
"""Difference of neighbours, times the stiffness, beyond which more costs no more."""
