"""The background comes back as it was."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.frames import CameraId
from pipeline.segmentation.background import CameraBackground
from service.background_folder import read_background, write_background

SHAPES = st.tuples(st.integers(1, 40), st.integers(1, 40))
CLEAN = np.array([[1, 2], [3, 4]], np.float32)
KEPT = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@KEPT
@given(
    shapes=st.dictionaries(st.from_regex(r"[a-z0-9_-]{1,12}", fullmatch=True), SHAPES, min_size=1, max_size=4)
)
def test_what_is_mapped_is_what_was_written(shapes: dict[str, tuple[int, int]], tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    model = {
        CameraId(name): CameraBackground(
            mean=rng.random(shape, np.float32), n_frames=3, n_refused=1, clean=CLEAN
        )
        for name, shape in shapes.items()
    }
    with TemporaryDirectory(dir=tmp_path) as folder:
        write_background(Path(folder), model)
        read = read_background(Path(folder))
        assert set(read) == set(model)
        for camera, known in read.items():
            assert type(known.mean) is np.ndarray
            assert np.array_equal(known.mean, model[camera].mean)
            assert (known.n_frames, known.n_refused, known.refused) == (3, 1, None)
            assert known.clean is not None
            assert np.array_equal(known.clean, CLEAN)
