"""What is wrong with a calibration, in words that name the remedy."""

from dataclasses import dataclass

from pipeline.frames import CameraId


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """One finding; a fatal one forbids the use of the calibration."""

    code: str  # for programs, such as `too_few_drops`
    detail: str  # for people: what is wrong and the remedy
    camera: CameraId | None = None
    is_fatal: bool = True
