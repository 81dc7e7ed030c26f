import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from support.extents import examples

from pipeline.arrays import Faces
from pipeline.geometry.decimation import decimated
from pipeline.geometry.icosphere import icosphere


def surplus(faces: Faces) -> int:
    """Return the number of directed edges that no other face has the other way round."""
    edges = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    counts: dict[tuple[int, int], int] = {}
    for low, high in edges.tolist():
        key, way = ((low, high), 1) if low < high else ((high, low), -1)
        counts[key] = counts.get(key, 0) + way
    return sum(map(abs, counts.values()))


@pytest.mark.parametrize("n_vertices", [500, 2500])
def test_a_ball_keeps_volume_place_and_greys(n_vertices: int) -> None:
    directions, faces = icosphere(subdivisions=6)
    vertices_mm = 9.0 * directions + [5.0, -3.0, 100.0]
    greys = np.where(directions[:, 2] > 0, 200, 50).astype(np.uint8)
    few_mm, few_faces, few_greys = decimated(vertices_mm, faces, greys, n_vertices)
    assert len(few_mm) == pytest.approx(n_vertices, rel=0.25)
    few = trimesh.Trimesh(few_mm, few_faces, process=False)
    assert few.is_watertight
    assert few.volume == pytest.approx(4 / 3 * np.pi * 9**3, rel=15 / n_vertices)
    assert np.linalg.norm(few_mm - [5.0, -3.0, 100.0], axis=1) == pytest.approx(9.0, abs=9 * 10 / n_vertices)
    assert few_greys is not None
    heights_mm = few_mm[:, 2] - 100
    assert (few_greys[heights_mm > 1.5] == 200).all()
    assert (few_greys[heights_mm < -1.5] == 50).all()


@examples(1)
@given(stretch=st.tuples(*3 * [st.floats(0.02, 2)]), n_vertices=st.integers(4, 2000), seed=st.integers(0, 99))
def test_a_closed_mesh_stays_closed_whatever_its_form(
    stretch: tuple[float, float, float], n_vertices: int, seed: int
) -> None:
    directions, faces = icosphere(subdivisions=4)
    rough = 1 + 0.2 * np.random.default_rng(seed).random((len(directions), 1))
    few_mm, few_faces, few_greys = decimated(directions * rough * stretch, faces, None, n_vertices)
    assert few_greys is None
    assert surplus(few_faces) == 0
    assert few_faces.max(initial=0) < len(few_mm)
    assert np.isfinite(few_mm).all()
    corners = np.sort(few_faces, axis=1)
    assert (np.diff(corners, axis=1) > 0).all(), "no face has two corners in one vertex"


def test_a_small_mesh_is_returned_as_it_is() -> None:
    directions, faces = icosphere(subdivisions=2)
    same, same_faces, greys = decimated(directions, faces, None, len(directions))
    assert (same is directions, same_faces is faces, greys) == (True, True, None)
