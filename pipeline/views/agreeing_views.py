"""How far the outlines of views that agree leave the hull of the others: nearly nowhere.

What two calibrated views see of a body agrees if their tangents do, so each ray along an outline touches the
body, on what the others' tangent planes leave of it, and one point where nobody denies the body settles that.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.carving import View
from pipeline.rig.camera_arrays import arrays_of
from pipeline.segmentation.silhouette import MARGIN_PX
from pipeline.views.clearance import STEPS, of_views, outline_rays
from pipeline.views.epipolar_tangency import OutlineHulls
from pipeline.views.ray_field import Steps, field_of, highest_mm
from pipeline.views.tangent_planes import planes_around, stretches_mm

Array = NDArray[np.float64]

SEARCHES: Sequence[tuple[float, Steps]] = (
    (1.5, ((1, 1), (5, 3), (17, 1), (9, 1))),
    (MARGIN_PX + 1, STEPS),
)
"""By how many pixels planes are moved outwards, and samples: a ray that is (nearly) as far outside is searched anew."""
NEARLY_PX = 0.5


def claims_px(views: Sequence[View], hulls: OutlineHulls) -> list[Array]:
    """For each view the clearances (N_RAYS,) of rays along its outline, but 0 where they are not below zero."""
    cameras = arrays_of([camera for camera, _ in views])
    rays = outline_rays(views, cameras, np.zeros(3))
    field, planes = field_of(views, cameras, overruled=0), planes_around(views, cameras, hulls)
    found_px, left = np.empty(len(rays.owners)), np.arange(len(rays.owners))
    for slack_px, steps in SEARCHES:
        some = rays.some(left)
        low_mm, high_mm = stretches_mm(planes, some.lines, slack_px)
        found_mm = highest_mm(field, some, low_mm, high_mm, steps, enough_mm=np.zeros(len(left)))
        found_px[left] = np.clip(found_mm * some.px_per_mm, -MARGIN_PX, 0)
        left = left[found_px[left] < NEARLY_PX - slack_px]
        if len(left) == 0:
            break
    return of_views(found_px, rays, views)
