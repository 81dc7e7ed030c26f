"""Geometric calibration of the rig from balls, or stones, that fall through it."""

from pipeline.calibration.ball_outline import observe_ball
from pipeline.calibration.calibration import calibrate
from pipeline.calibration.drops import BallDrop, BallView
from pipeline.calibration.report import CalibrationReport, ScaleSource, report_document
from pipeline.errors import CalibrationError, CalibrationProblem

__all__ = [
    "BallDrop",
    "BallView",
    "CalibrationError",
    "CalibrationProblem",
    "CalibrationReport",
    "ScaleSource",
    "calibrate",
    "observe_ball",
    "report_document",
]
