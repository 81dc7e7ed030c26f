"""Our icosphere against trimesh's."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from pipeline.geometry.icosphere import icosphere


@pytest.mark.parametrize("subdivisions", range(4))
def test_icosphere_is_trimesh_s(subdivisions: int) -> None:
    vertices, triangles = icosphere(subdivisions)
    ours = trimesh.Trimesh(vertices, triangles, process=False)
    reference = trimesh.creation.icosphere(subdivisions)
    assert ours.is_watertight and ours.volume == pytest.approx(reference.volume, rel=1e-12)
    assert len(triangles) == 20 * 4**subdivisions
    distances, nearest = KDTree(vertices).query(reference.vertices)
    assert distances.max() < 1e-12
    assert len(np.unique(nearest)) == len(vertices)
