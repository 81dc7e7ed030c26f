"""Aperture and focus distance of the lenses, from the widths of the edges of balls at known depths.

An edge has the sigma of `pipeline.rig.depth_blur`: least in focus, greater the further from it. All lenses share one
aperture and one blur in focus; each camera has a focus distance of its own. The edge of a ball is its limb, a little
nearer than its centre.
"""

from collections.abc import Sequence

import numpy as np
import scipy  # imports its submodules on use

from pipeline.arrays import PointsMM, Values
from pipeline.calibration.drops import BallDrop
from pipeline.calibration.report import FoundLenses, NumberWithSd, UnseenLenses
from pipeline.rig.cameras import CameraCalibration, Lens
from pipeline.rig.depth_blur import SIGMA_OF_DISC
from pipeline.rig.design import FOCAL_MM

MIN_VIEWS = 4
"""Fewest views of a camera with a measured width: two show a focus, two more reveal an outlier."""
NOISE = 0.03
"""Relative error of a width beyond which the loss grows linearly."""
FOCUS_PRIOR_MM = 30.0
"""Standard deviation of a focus distance from the middle of the camera's balls, for balls that do not show it."""
FIRST_APERTURE_MM2 = 100.0
"""Square of the aperture at which the search begins: a lens of 25 mm at F2.5."""
MIN_SIGMA_PX = 0.1
MAX_APERTURE_SD = 0.15
"""Largest relative standard deviation of an aperture that counts as found."""
MAX_FOCUS_SD_MM = 4.0
"""Largest standard deviation of a focus distance that counts as found."""
STOPPED_DOWN = 11.0
"""F-number beyond which widths show neither aperture nor focus: 10 mm out of focus an edge is 10 % wider."""


def fit_lenses(
    drops: Sequence[BallDrop], cameras: Sequence[CameraCalibration], centers_mm: PointsMM
) -> FoundLenses | UnseenLenses:
    """Return the lenses of calibrated cameras that saw balls at `centers_mm` (D, 3), or why they do not show."""
    seen = [
        (index, _limb_depth_mm(drop, camera, center_mm), sigma_px)
        for drop, center_mm in zip(drops, centers_mm, strict=True)
        for index, camera in enumerate(cameras)
        if (view := drop.views.get(camera.id)) is not None and (sigma_px := view.edge_sigma_px)
    ]
    n_seen = np.bincount([index for index, _, _ in seen], minlength=len(cameras))
    if n_seen.max() < MIN_VIEWS:
        return UnseenLenses.NO_WIDTHS
    owner = np.array([index for index, _, _ in seen])
    depths_mm, sigmas_px = np.array([(depth_mm, sigma_px) for _, depth_mm, sigma_px in seen]).T
    focals_px = np.array([camera.focal_px for camera in cameras])[owner]
    middles_mm = np.array(
        [np.median(depths_mm[owner == index]) if n else 1.0 for index, n in enumerate(n_seen)]
    )
    prior = FOCUS_PRIOR_MM / middles_mm**2  # of the inverse focus distance, in which the model is a parabola

    def relative_errors(unknowns: Values) -> Values:
        discs_px = focals_px * ((1 / middles_mm + prior * unknowns[2:])[owner] - 1 / depths_mm)
        variances = unknowns[1] ** 2 + unknowns[0] * (SIGMA_OF_DISC * discs_px) ** 2
        return np.log(np.maximum(variances, MIN_SIGMA_PX**2)) / 2 - np.log(sigmas_px)

    first = np.concatenate([[FIRST_APERTURE_MM2, sigmas_px.min()], np.zeros(len(cameras))])
    found = scipy.optimize.least_squares(
        lambda unknowns: np.append(relative_errors(unknowns) / NOISE, unknowns[2:]),
        first,
        loss="soft_l1",
        x_scale=np.maximum(first, 1.0),
    )
    noise = 1.4826 * float(np.median(np.abs(relative_errors(found.x)))) / NOISE
    covariance = noise**2 * np.linalg.pinv(found.jac.T @ found.jac)
    sd = np.sqrt(np.diag(covariance))
    squared, squared_sd, focal_mm = found.x[0], sd[0], _nominal_focal_mm(cameras)
    if max(squared, 0) + 2 * squared_sd < (focal_mm / STOPPED_DOWN) ** 2:
        return UnseenLenses.STOPPED_DOWN
    if squared_sd > 2 * MAX_APERTURE_SD * squared:
        return UnseenLenses.LITTLE_DEPTH
    f_number = focal_mm / float(np.sqrt(squared))
    focus_mm = 1 / (1 / middles_mm + prior * found.x[2:])
    focus_sd_mm = prior * sd[2:] * focus_mm**2
    return FoundLenses(
        focal_length_mm=focal_mm,
        f_number=NumberWithSd(value=f_number, sd=f_number * float(squared_sd / (2 * squared))),
        blur_px=NumberWithSd(value=abs(float(found.x[1])), sd=float(sd[1])),
        focus_mm={
            camera.id: NumberWithSd(value=float(focus_mm[index]), sd=float(focus_sd_mm[index]))
            for index, camera in enumerate(cameras)
            if n_seen[index] >= MIN_VIEWS and focus_sd_mm[index] <= MAX_FOCUS_SD_MM
        },
    )


def lens_of(camera: CameraCalibration, found: FoundLenses | UnseenLenses) -> Lens | None:
    """Return a camera's lens, None where the balls do not show it."""
    if isinstance(found, UnseenLenses) or camera.id not in found.focus_mm:
        return None
    return Lens(
        focal_length_mm=found.focal_length_mm,
        f_number=found.f_number.value,
        focus_mm=found.focus_mm[camera.id].value,
        blur_px=found.blur_px.value,
    )


def _limb_depth_mm(drop: BallDrop, camera: CameraCalibration, center_mm: Values) -> float:
    """Return the depth of the circle in which viewing rays touch a ball."""
    distance_mm = float(np.linalg.norm(center_mm - camera.center_mm))
    depth_mm = float(camera.R[2] @ center_mm + camera.t_mm[2])
    return depth_mm * (1 - ((drop.diameter_mm or 0.0) / 2 / distance_mm) ** 2)


def _nominal_focal_mm(cameras: Sequence[CameraCalibration]) -> float:
    """Return the focal length on the lenses' barrels: as the rig file has it, or else the design's."""
    return next((camera.lens.focal_length_mm for camera in cameras if camera.lens is not None), FOCAL_MM)
