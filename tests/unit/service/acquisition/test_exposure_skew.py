import numpy as np
import pytest

from pipeline.frames import CameraId
from service.acquisition.exposure_skew import ExposureSkew

CAMERAS = [CameraId(f"c{number:02d}") for number in range(1, 9)]


def exposures(n_bundles: int, *, jitter_us: dict[CameraId, float], seed: int = 1):
    """Camera times of each bundle: free clocks that drift by up to 50 ppm, and trigger jitter."""
    rng = np.random.default_rng(seed)
    offsets_ns, drifts = rng.integers(1, 10**15, len(CAMERAS)), rng.uniform(-50e-6, 50e-6, len(CAMERAS))
    moments_ns = np.cumsum(rng.uniform(0.25e9, 2e9, n_bundles))
    for moment_ns in moments_ns:
        yield {
            camera: int(offset + (moment_ns + 1e3 * rng.normal(0, jitter_us.get(camera, 0.5))) * (1 + drift))
            for camera, offset, drift in zip(CAMERAS, offsets_ns, drifts, strict=True)
        }


@pytest.mark.parametrize("seed", range(3))
def test_the_camera_with_the_bad_trigger_stands_out_of_free_running_clocks(seed: int):
    skew = ExposureSkew()
    for bundle in exposures(100, jitter_us={CAMERAS[2]: 100.0}, seed=seed):
        skew.feed(bundle)
    bad_us = skew.skew_us(CAMERAS[2])
    assert bad_us is not None
    assert bad_us > 40
    others_us = [skew.skew_us(camera) for camera in CAMERAS if camera != CAMERAS[2]]
    assert all(us is not None and us < 10 for us in others_us)


def test_a_clock_that_was_set_and_a_view_that_is_missing_are_no_skew():
    skew = ExposureSkew()
    for number, bundle in enumerate(exposures(100, jitter_us={})):
        if number >= 30:
            bundle[CAMERAS[0]] -= 10**9
        if number % 3 == 0:
            del bundle[CAMERAS[1]]
        skew.feed(bundle)
    assert all((us := skew.skew_us(camera)) is not None and us < 10 for camera in CAMERAS)


def test_the_skew_is_unknown_with_two_cameras_or_without_clocks():
    skew = ExposureSkew()
    for bundle in exposures(20, jitter_us={}):
        skew.feed(dict(list(bundle.items())[:2]) | {CAMERAS[5]: 0})
    assert {skew.skew_us(camera) for camera in CAMERAS} == {None}
