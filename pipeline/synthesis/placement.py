"""Random poses of falling bodies at the middle of the exposure."""

from collections.abc import Callable

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from pipeline.arrays import PointsMM, Vector
from pipeline.rig.cameras import RigCalibration
from pipeline.synthesis.bodies import Body
from pipeline.synthesis.renderer import PlacedBody

OFFSET_SD_MM = 1.5
"""Standard deviation of a body's offset from the centre along each axis."""
MAX_OFFSET_SD = 3.0
HALF_VOLUME_MM = 24.5
"""Half the edge of the reconstructed cube, less a margin."""
SPREAD_MM = (9.0, 9.0, 9.0)
"""Greatest offset of calibration balls from the centre along each axis: the volume that stones are measured in."""
BORDER_PX = 8.0
"""Margin that a body keeps to the border of each image."""
PX_PER_MM = 20.0  # in the middle of the design
N_TRIES = 60


def tumble(body: Body, rig: RigCalibration, rng: np.random.Generator) -> PlacedBody:
    """Place the body in a random pose near the centre, whole in every view and inside the volume.

    A body too large for that anywhere near the centre is placed where least of it is cut off.
    """
    return _placed(
        body, rig, rng, lambda: OFFSET_SD_MM * np.clip(rng.normal(size=3), -MAX_OFFSET_SD, MAX_OFFSET_SD)
    )


def drop_across(
    body: Body,
    rig: RigCalibration,
    rng: np.random.Generator,
    spread_mm: tuple[float, float, float] = SPREAD_MM,
    fallen_mm: float = 0.0,
) -> PlacedBody:
    """Place the body as `tumble` does, anywhere within `spread_mm` of the centre along x, y and z.

    It is `fallen_mm` further down.
    """
    below_mm = np.array([0.0, 0.0, fallen_mm])
    return _placed(body, rig, rng, lambda: np.array(spread_mm) * rng.uniform(-1, 1, size=3) - below_mm)


def _placed(
    body: Body, rig: RigCalibration, rng: np.random.Generator, draw_offset_mm: Callable[[], Vector]
) -> PlacedBody:
    hull_mm = body.mesh.vertices[ConvexHull(body.mesh.vertices).vertices]
    placements = []
    for _ in range(N_TRIES):
        R = Rotation.random(rng=rng).as_matrix()
        offset_mm = draw_offset_mm()
        cut_px = _cut_off_px(hull_mm @ R.T + offset_mm, rig)
        placements.append((cut_px, PlacedBody(body=body, R=R, offset_mm=offset_mm)))
        if cut_px <= 0:
            break
    return min(placements, key=lambda placement: placement[0])[1]


def _cut_off_px(points_world_mm: PointsMM, rig: RigCalibration) -> float:
    """Largest distance, px, of the points beyond images or volume; at most 0 if they are inside."""
    beyond = [float(np.abs(points_world_mm).max() - HALF_VOLUME_MM) * PX_PER_MM]
    for camera in rig.cameras:
        pixels_uv, _ = camera.project(points_world_mm)
        far = np.array(camera.image_size_px) - 1 - BORDER_PX
        beyond.append(float(max((BORDER_PX - pixels_uv).max(), (pixels_uv - far).max())))
    return max(beyond)
