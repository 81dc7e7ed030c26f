"""The clearances of views whose tangents agree: nearly nowhere does an outline leave the hull of the others.

What two calibrated views see of a body agrees if their tangents do, so each ray along an outline touches the body on
the stretch that the others' tangent planes leave of it. One point there at which no view excludes the body settles it.
"""

from collections.abc import Sequence

import numpy as np

from pipeline.arrays import Values
from pipeline.segmentation.silhouette import MARGIN_PX
from pipeline.views.clearance import REFINEMENTS, outline_rays, split_by_view
from pipeline.views.distance_field import Refinements, distance_field, maximum_mm
from pipeline.views.epipolar_tangency import OutlineHulls
from pipeline.views.prepared import PreparedViews
from pipeline.views.tangent_planes import planes_around, stretches_mm

SEARCHES: Sequence[tuple[float, Refinements]] = (
    (1.5, ((1, 1), (5, 3), (17, 1), (9, 1))),
    (MARGIN_PX + 1, REFINEMENTS),
)
"""Slack in pixels by which planes are moved outwards, and samples; rays (nearly) as far outside are searched anew."""
NEARLY_PX = 0.5


def negative_clearances_px(views: PreparedViews, hulls: OutlineHulls) -> list[Values]:
    """Return for each of agreeing views the clearances (R,) of rays along its outline, 0 for those above zero."""
    rays = outline_rays(views, np.zeros(3))
    field, planes = distance_field(views, overruled=0), planes_around(views, hulls)
    found_px, left = np.empty(len(rays.owners)), np.arange(len(rays.owners))
    for slack_px, refinements in SEARCHES:
        searched = rays.subset(left)
        low_mm, high_mm = stretches_mm(planes, searched.lines, slack_px)
        found_mm = maximum_mm(field, searched, low_mm, high_mm, refinements, enough_mm=np.zeros(len(left)))
        found_px[left] = np.clip(found_mm * searched.px_per_mm, -MARGIN_PX, 0)
        left = left[found_px[left] < NEARLY_PX - slack_px]
        if len(left) == 0:
            break
    return split_by_view(found_px, rays, len(views))
