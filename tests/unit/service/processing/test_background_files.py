"""The background comes back as it was."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numba.core import event
from numpy.typing import NDArray

from pipeline.frames import CameraId, Frame
from pipeline.segmentation.background import (
    SETTLED_FRAMES,
    BackgroundModel,
    CameraBackground,
    learn_background,
)
from pipeline.segmentation.optics import observe_optics
from pipeline.segmentation.segmenter_choice import ChoosingSegmenter, warm_up
from pipeline.segmentation.silhouette import ViewStatus
from pipeline.segmentation.subtraction import BackgroundSegmenter
from service.processing.backgrounds import DERIVED, read_background, write_background

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
            for name in DERIVED:
                kept = vars(known)[name]
                np.testing.assert_array_equal(kept, getattr(model[camera], name))
                assert kept.dtype == getattr(model[camera], name).dtype
            assert np.array_equal(known.mean, model[camera].mean)
            assert (known.n_frames, known.n_refused, known.refused) == (3, 1, None)
            assert known.clean is not None
            assert np.array_equal(known.clean, CLEAN)


def test_for_a_settled_rig_nothing_is_compiled_anew(tmp_path: Path) -> None:
    """From the fifth exposure on the flat field is an array from a file, too; stones waited 1.3 s for that."""
    warm_up()
    rng = np.random.default_rng(2)
    wall, camera = rng.integers(190, 210, (256, 320), np.uint8), CameraId("c01")
    settled: BackgroundModel = {}
    for version in range(SETTLED_FRAMES):
        folder = tmp_path / str(version)
        write_background(folder, learn_background(settled, {camera: frame_of(wall)}))
        settled = read_background(folder)
    assert settled[camera].clean is not None
    image = wall.copy()
    image[50:90, 60:100] = 60
    with event.install_recorder("numba:compile") as compilations:
        silhouette = ChoosingSegmenter(classical=BackgroundSegmenter(), network=None)(
            frame_of(image), settled
        )
        assert silhouette.status is ViewStatus.OK
        assert observe_optics(frame_of(image), settled, silhouette) is not None
    assert not compilations.buffer


def frame_of(image: NDArray[np.uint8]) -> Frame:
    return Frame(camera=CameraId("c01"), image=image.copy(), frame_id=0, device_ns=0, received_ns=0)
