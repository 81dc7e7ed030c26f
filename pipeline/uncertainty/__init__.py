"""Uncertainty of one measured stone, by cause, and the word for it."""

from pipeline.uncertainty.causes import Cause
from pipeline.uncertainty.evidence import Evidence, PixelSupport, ViewEvidence
from pipeline.uncertainty.model import Uncertainty, uncertainty
from pipeline.uncertainty.word import QualityParameters, QualityVerdict, verdict

__all__ = [
    "Cause",
    "Evidence",
    "PixelSupport",
    "QualityParameters",
    "QualityVerdict",
    "Uncertainty",
    "ViewEvidence",
    "uncertainty",
    "verdict",
]
