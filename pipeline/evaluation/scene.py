"""A simulated rig with manufacturing deviations, ready to render bodies, and the balls that calibrate it."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.arrays import Matrix33, Vector
from pipeline.calibration import BallDrop, observe_ball
from pipeline.frames import FrameBundle
from pipeline.rig.camera_arrays import nearest_point
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.segmentation import BackgroundModel
from pipeline.segmentation.background import learn_background
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.background import WallKind
from pipeline.synthesis.bodies import ball
from pipeline.synthesis.bundles import render_bundle, render_empty, stream
from pipeline.synthesis.exposure import ExposureParameters
from pipeline.synthesis.placement import drop_across
from pipeline.synthesis.renderer import PlacedBody, RenderedRig, simulate_rig

HOUSING, EMPTY, BALL, BODY = range(4)
"""Keys of a scene's random streams: what one exposure shows does not depend on the others."""
N_EMPTY = 4
"""Exposures of the empty rig that the background is learnt from."""
COMPARED_MM = 12.0
"""Half the edge of the cube in which two rigs are compared."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EvaluationScene:
    """A rig with deviations in its housing, and its background model."""

    seed: int
    simulated: RenderedRig
    background: BackgroundModel

    @property
    def true_rig(self) -> RigCalibration:
        return self.simulated.rig

    def photograph(self, placed: PlacedBody, rng: np.random.Generator, label: str) -> FrameBundle:
        return render_bundle([placed], self.simulated, rng, sequence=1, label=label)


def build_scene(
    seed: int,
    design: RigCalibration | None = None,
    exposure: ExposureParameters | None = None,
    wall_kind: WallKind = WallKind.PANELS,
) -> EvaluationScene:
    """Build the nominal rig, or another design, with the deviations of `as_built`, and learn its background."""
    rig = as_built(design or nominal_rig(), seed)
    simulated = simulate_rig(rig, stream(seed, HOUSING), exposure, wall_kind)
    background: BackgroundModel = {}
    for number in range(N_EMPTY):
        empty = render_empty(simulated, stream(seed, EMPTY, number), sequence=number + 1)
        background = learn_background(background, empty.frames)
    return EvaluationScene(seed=seed, simulated=simulated, background=background)


def photograph_drop(scene: EvaluationScene, number: int, diameter_mm: float) -> FrameBundle:
    """Render drop number `number` of a ball: one frame of each camera."""
    rng = stream(scene.seed, BALL, number)
    placed = drop_across(ball(diameter_mm), scene.true_rig, rng)
    return scene.photograph(placed, rng, f"ball-{number}")


def drop_ball(scene: EvaluationScene, number: int, diameter_mm: float) -> BallDrop:
    """Return the same drop as `photograph_drop`, segmented."""
    bundle = photograph_drop(scene, number, diameter_mm)
    return observe_ball(bundle, scene.background, BackgroundSegmenter(), diameter_mm)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigDifference:
    """The difference of a calibrated rig from the true one: x_true = R @ x + t, and the residuals after that."""

    R: Matrix33
    t_mm: Vector
    rms_mm: float  # of points within +-12 mm, after the rigid motion
    scale_percent: float  # of lengths, on average
    length_percent: float  # greatest relative error of a length, over all directions


def rig_error(rig: RigCalibration, true_rig: RigCalibration) -> RigDifference:
    """Compare points in the measuring volume with their triangulation by `rig` from images by `true_rig`.

    They are triangulated where their rays pass nearest, and aligned by a rigid motion in least squares (Kabsch 1976):
    a calibration has no absolute pose, and particles do not depend on it.
    """
    axis_mm = np.linspace(-COMPARED_MM, COMPARED_MM, 5)
    points_mm = np.stack(np.meshgrid(axis_mm, axis_mm, axis_mm), axis=-1).reshape(-1, 3)
    cameras = zip(rig.cameras, true_rig.cameras, strict=True)
    rays = np.stack([camera.rays(true.project(points_mm)[0]) for camera, true in cameras], axis=1)
    origins_mm = np.array([camera.center_mm for camera in rig.cameras])
    found_mm = np.array([nearest_point(origins_mm, directions) for directions in rays])
    middle_mm = found_mm.mean(axis=0)
    R = Rotation.align_vectors(points_mm, found_mm - middle_mm)[0].as_matrix()
    t_mm = -R @ middle_mm  # the points' own mean is the origin
    back_mm = found_mm @ R.T + t_mm
    strain = np.linalg.lstsq(points_mm, back_mm)[0] - np.eye(3)
    return RigDifference(
        R=R,
        t_mm=t_mm,
        rms_mm=float(np.sqrt(((back_mm - points_mm) ** 2).sum(axis=1).mean())),
        scale_percent=100 * (float(np.linalg.norm(back_mm) / np.linalg.norm(points_mm)) - 1),
        length_percent=100 * float(np.abs(np.linalg.eigvalsh((strain + strain.T) / 2)).max()),
    )
