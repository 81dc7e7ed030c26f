"""Apparent diameters of the balls: which of two sizes fell, and whether the entered diameters can be true.

In a rig known only to a degree and a few millimetres, apparent diameters are wrong by some percent, but by the same
factor for all balls: ratios of sizes are ten times as accurate as sizes.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.calibration.coverage import ball_center_mm
from pipeline.calibration.drops import BallDrop
from pipeline.errors import CalibrationError, CalibrationProblem, ProblemCode
from pipeline.rig.cameras import RigCalibration

MAX_SCATTER = 0.03
"""Relative scatter of one ball's apparent diameters in a rough rig; balls that differ by less cannot be told apart."""


def apparent_diameter_mm(drop: BallDrop, rig: RigCalibration) -> float | None:
    """Return the ball's diameter as `rig` has it, the median over the views; `None` with fewer than two views.

    The tangent cone of a ball of diameter D has the half-angle asin(D / 2 distance).
    """
    center_mm = ball_center_mm(drop, rig)
    if center_mm is None:
        return None
    diameters_mm = []
    for camera in rig.cameras:
        if (view := drop.views.get(camera.id)) is not None:
            half_angle = np.arctan(view.radius_px / camera.focal_px)
            diameters_mm.append(2 * np.linalg.norm(center_mm - camera.center_mm) * np.sin(half_angle))
    return float(np.median(diameters_mm))


def with_diameters(
    drops: Sequence[BallDrop], rig: RigCalibration, diameters_mm: Sequence[float]
) -> tuple[BallDrop, ...]:
    """Return the drops, each with that of the entered diameters to which its apparent size belongs.

    With two diameters the drops fall into two groups. For this the diameters need not be right, they only have to
    differ by more than the apparent sizes scatter.

    Raises
    ------
    CalibrationError
        The drops do not fall into two groups.
    """
    if len(diameters_mm) < 2:
        diameter_mm = diameters_mm[0] if diameters_mm else None
        return tuple(replace(drop, diameter_mm=diameter_mm) for drop in drops)
    small_mm, large_mm = sorted(diameters_mm)
    sizes_mm = {drop.name: size for drop in drops if (size := apparent_diameter_mm(drop, rig)) is not None}
    logs = np.sort(np.log(list(sizes_mm.values())))
    gaps = np.diff(logs)
    widest = int(gaps.argmax()) if len(gaps) else 0
    if not len(gaps) or gaps[widest] < max(np.log(large_mm / small_mm) / 2, MAX_SCATTER):
        seen = (
            f"all look {np.exp(logs[0]):.1f} to {np.exp(logs[-1]):.1f} mm" if len(logs) else "none was seen"
        )
        problem = CalibrationProblem(
            code=ProblemCode.AMBIGUOUS_SIZES,
            detail=f"balls of {small_mm:g} and {large_mm:g} mm were entered, but the drops do not show two sizes: "
            f"{seen}; enter the diameter of the one ball, or drop both",
        )
        raise CalibrationError([problem])
    middle = np.exp((logs[widest] + logs[widest + 1]) / 2)
    return tuple(
        replace(drop, diameter_mm=small_mm if sizes_mm.get(drop.name, 0.0) < middle else large_mm)
        for drop in drops
    )


def ratio_per_edge_px(small_mm: float, large_mm: float, rig: RigCalibration) -> float:
    """Return the relative change of the ratio of two balls' apparent sizes per pixel by which outlines are too large.

    Both radii grow by the same amount, that of the smaller ball by the larger factor.
    """
    px_per_mm = np.mean([camera.focal_px / np.linalg.norm(camera.center_mm) for camera in rig.cameras])
    return float((2 / small_mm - 2 / large_mm) / px_per_mm)


def either_wrong(small_mm: float, large_mm: float, relative: float) -> str:
    """Describe the two explanations if the ratio of two entered diameters must be multiplied by `relative`."""
    return (
        f"either the {small_mm:g} mm ball is {small_mm * relative:.2f} mm, "
        f"or the {large_mm:g} mm ball is {large_mm / relative:.2f} mm"
    )
