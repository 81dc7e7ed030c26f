"""Before the first stone the estimate is compiled, all the way."""

import numpy as np
import pytest
from support.silhouettes import sphere_silhouettes

from pipeline.carving import CarvingParameters, carve
from pipeline.estimate import body, estimate_body, inner, smoothness, surface, tangents, warm_up
from pipeline.geometry import growing_hull
from pipeline.meshing import mesh_hull
from pipeline.rig.design import nominal_rig
from pipeline.segmentation.ball_silhouettes import RADIUS_MM
from pipeline.views.prepared import prepare_views


def test_after_the_warm_up_nothing_is_left_to_compile() -> None:
    modules = (body, growing_hull, inner, smoothness, surface, tangents)
    kernels = [value for module in modules for value in vars(module).values() if hasattr(value, "signatures")]
    made_up = warm_up()
    assert made_up.fallback is None
    assert made_up.volume_mm3 == pytest.approx(4 / 3 * np.pi * RADIUS_MM**3, rel=0.05)
    compiled = [kernel.signatures for kernel in kernels]
    assert sum(map(bool, compiled)) > 10
    rig = nominal_rig()
    silhouettes = sphere_silhouettes(rig)
    hull = mesh_hull(carve(prepare_views(silhouettes, rig), CarvingParameters()))
    assert hull is not None
    assert estimate_body(hull, prepare_views(silhouettes, rig)).fallback is None
    assert [kernel.signatures for kernel in kernels] == compiled
