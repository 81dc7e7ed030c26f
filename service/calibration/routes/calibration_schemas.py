"""Schemas of calibrations in the REST interface."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from pipeline.calibration.coverage import Coverage
from pipeline.frames import CameraId
from service.base.schema import Name, adds_to
from service.calibration.drop_files import ObservedDrop
from service.calibration.files import Activation, CalibrationRecord


class Signature(BaseModel):
    """The person who decides."""

    model_config = ConfigDict(extra="forbid")

    by: Name | None = Field(default=None, description="Kept with the decision")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationSummary(CalibrationRecord):
    """One calibration. It is open until it is accepted, rejected or cancelled; an accepted one is a version."""

    __pydantic_config__ = adds_to(CalibrationRecord)

    is_active: bool
    """True if stones are measured with it now."""


class CalibrationsAnswer(BaseModel):
    """All calibrations, newest first, and the history of activations."""

    active: Activation = Field(description="The one in use, since when and by whom")
    items: list[CalibrationSummary] = Field(description="Newest first")
    activations: list[Activation] = Field(description="All of them, newest first")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationDocument(CalibrationSummary):
    """One calibration with its drops and its report."""

    __pydantic_config__ = adds_to(CalibrationSummary)

    drops: Sequence[ObservedDrop]
    """In the order in which they fell."""
    coverage: Coverage
    """How well the drops so far cover volume and images."""
    residuals_before_px: Mapping[CameraId, float]
    """Per camera, rms over the drops so far, with the calibration in use when they fell, px."""
    report: Mapping[str, Any] | None
    """Result of the solution: residuals before and after (px), drops and views left out, centres of the balls (mm),
    f-number and focus of the lenses (mm) or why they do not show, uncertainty, problems; null before it is solved."""
