"""The background comes back as it was, and lies where it can be mapped."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.frames import CameraId
from pipeline.segmentation.background import CameraBackground
from service.background_file import read_background, write_background

SHAPES = st.tuples(st.integers(1, 40), st.integers(1, 40))
KEPT = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@KEPT
@given(
    shapes=st.dictionaries(st.from_regex(r"[a-z0-9_-]{1,12}", fullmatch=True), SHAPES, min_size=1, max_size=4)
)
def test_what_is_mapped_is_what_was_written(shapes: dict[str, tuple[int, int]], tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    model = {
        CameraId(name): CameraBackground(
            mean=rng.random(shape, np.float32), n_frames=3, n_refused=1, clean=rng.random((2, 2), np.float32)
        )
        for name, shape in shapes.items()
    }
    write_background(tmp_path / "background.npz", model)
    for mapped in (False, True):
        read = read_background(tmp_path / "background.npz", mapped=mapped)
        assert list(read) == list(model)
        for camera, known in read.items():
            assert np.array_equal(known.mean, model[camera].mean)
            assert known.mean.flags.writeable is not mapped  # of a view that was not aligned there is a copy
            assert (known.n_frames, known.n_refused, known.refused) == (3, 1, None)
            assert known.clean is not None
            assert known.clean.tobytes() == model[camera].clean.tobytes()


@pytest.mark.parametrize("name", ["c01", "c0123"])
def test_one_that_numpy_wrote_is_read_too(name: str, tmp_path: Path) -> None:
    """As those kept by an earlier release are."""
    mean = np.arange(12, dtype=np.float32).reshape(3, 4)
    np.savez(tmp_path / "old.npz", **{name: mean, f"{name}.counts": np.array([2, 0])})
    read = read_background(tmp_path / "old.npz", mapped=True)[CameraId(name)]
    assert np.array_equal(read.mean, mean)
    assert read.mean.flags.aligned
