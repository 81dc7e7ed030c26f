"""Direction of gravity, from balls exposed at different times of their fall."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.ball_drops import drop

from pipeline.calibration.calibration import by_bundle_adjustment
from pipeline.calibration.gravity import fall_of, upright
from pipeline.fall import GRAVITY_MM_S2
from pipeline.rig.design import as_built, nominal_rig

SPEED_MM_S = 2426.0
CLOCK_NS = 56_207_400_000


def falling(
    direction: np.ndarray, scatter_mm: float, n: int = 12, span_ms: float = 6.0, seed: int = 0
) -> tuple[np.ndarray, list[int | None]]:
    """Places (n, 3) of balls let go within `scatter_mm` of one place, and when they were exposed."""
    rng = np.random.default_rng(seed)
    times_s = np.linspace(-span_ms / 2, span_ms / 2, n) * 1e-3
    way_mm = SPEED_MM_S * times_s + GRAVITY_MM_S2 * times_s**2 / 2
    centers_mm = way_mm[:, None] * direction + rng.normal(0, scatter_mm, size=(n, 3)) + [1.0, -2.0, 0.5]
    return centers_mm, [CLOCK_NS + round(time * 1e9) for time in times_s]


def tilted(degrees: float) -> np.ndarray:
    return Rotation.from_euler("x", degrees, degrees=True).apply([0.0, 0.0, -1.0])


def test_direction_of_the_fall() -> None:
    fall = fall_of(*falling(tilted(1.3), 0.02))
    assert fall is not None
    assert np.rad2deg(np.arccos(tilted(1.3) @ fall.direction)) < 0.2
    assert fall.speed_mm_s == pytest.approx(SPEED_MM_S, rel=0.01)
    assert upright(fall).apply(fall.direction) == pytest.approx([0, 0, -1], abs=1e-9)


def test_one_bad_drop_does_not_matter() -> None:
    centers_mm, times_ns = falling(tilted(0.5), 0.01)
    centers_mm[4] += [6.0, 0.0, 0.0]
    fall = fall_of(centers_mm, times_ns)
    assert fall is not None
    assert np.rad2deg(np.arccos(tilted(0.5) @ fall.direction)) < 0.1


@pytest.mark.parametrize("times", ["same", "few", "unknown"])
def test_fall_that_is_not_shown(times: str) -> None:
    centers_mm, times_ns = falling(tilted(1.0), 0.02)
    match times:
        case "same":
            times_ns = [CLOCK_NS + 200 * number for number in range(len(times_ns))]
        case "few":
            centers_mm, times_ns = centers_mm[:3], times_ns[:3]
        case "unknown":
            times_ns = [None] * len(times_ns)
    assert fall_of(centers_mm, times_ns) is None


def test_scattered_drops_do_not_tell_the_vertical() -> None:
    assert fall_of(*falling(tilted(1.0), 3.0)) is None


def test_clock_that_was_set_in_between_is_left_out() -> None:
    centers_mm, times_ns = falling(tilted(1.0), 0.01)
    assert times_ns[0] is not None
    times_ns[0] += 10_000_000_000
    fall = fall_of(centers_mm, times_ns)
    assert fall is not None
    assert np.rad2deg(np.arccos(tilted(1.0) @ fall.direction)) < 0.2


def test_rig_is_turned_upright() -> None:
    nominal = nominal_rig()
    centers_mm, times_ns = falling(tilted(2.0), 0.005)
    true = as_built(nominal, 12)
    scattered = np.random.default_rng(3).uniform(-8, 8, size=(6, 3))
    drops = [
        *(
            drop(f"falling-{i}", true, center_mm, noise_px=0.02, fall_ns=time_ns)
            for i, (center_mm, time_ns) in enumerate(zip(centers_mm, times_ns, strict=True))
        ),
        *(drop(f"across-{i}", true, center_mm, noise_px=0.02) for i, center_mm in enumerate(scattered)),
    ]
    report = by_bundle_adjustment(drops, nominal, created_at="2026-01-01T00:00:00Z", name="upright")
    assert report.fall is not None
    way_mm = np.subtract(report.ball_centers_mm["falling-11"], report.ball_centers_mm["falling-0"])
    assert np.rad2deg(np.arccos(-way_mm[2] / np.linalg.norm(way_mm))) < 0.2
    # the cameras went along: they still see the balls where the report has them
    camera = report.rig.cameras[4]
    axis = camera.rays(drops[0].views[camera.id].center_uv)[0]
    to_ball_mm = np.array(report.ball_centers_mm["falling-0"]) - camera.center_mm
    assert np.rad2deg(np.arccos(axis @ to_ball_mm / np.linalg.norm(to_ball_mm))) < 0.01
