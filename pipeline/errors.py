"""The pipeline's errors, and why a bundle or a calibration is refused.

::

    PipelineError
    ├── RigError            a rig document is invalid; names the field
    ├── MeshError           a mesh bounds no volume; names the defect
    ├── CalibrationError    no calibration can be solved; carries the problems
    ├── ModelError          a segmentation network is missing or unusable; says what was expected
    └── RejectedError       a bundle shows no measurable stone; the reason becomes the outcome

Wrong arguments of a public function are plain `ValueError`.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from pipeline.frames import CameraId


class RejectReason(StrEnum):
    """Why a bundle ends as `rejected`. The word is part of the REST contract."""

    EMPTY = "empty"
    """Most views show the empty rig."""
    MULTIPLE = "multiple"
    """Several views show more than one body."""
    CLIPPED = "clipped"
    """The body leaves the image in several views, or it leaves the carved volume."""
    INSUFFICIENT_VIEWS = "insufficient_views"
    """Too few views are usable, or those of a whole hemisphere are missing."""
    INCONSISTENT = "inconsistent"
    """More views contradict the others than may be dropped: they do not show one rigid body at one instant."""
    UNSEEN = "unseen"
    """In half of the views most of the outline is not seen: body and wall look alike, or something hides the body."""
    NO_BACKGROUND = "no_background"
    """The empty rig was never photographed, so the views have no reference."""
    IMPLAUSIBLE = "implausible"
    """The visual hull has no closed surface or no volume, or the silhouettes contradict themselves."""


class ProblemCode(StrEnum):
    """What is wrong with a calibration. The word is part of the REST contract and of the report files."""

    # the drops, before anything is solved
    TOO_FEW_DROPS = "too_few_drops"
    FEW_DROPS = "few_drops"
    CAMERA_SAW_TOO_FEW = "camera_saw_too_few"
    AMBIGUOUS_SIZES = "ambiguous_sizes"
    """Balls of two diameters were entered, but the drops do not show two sizes."""
    MIXED_SIZES = "mixed_sizes"
    """Balls entered with one diameter differ in size."""
    WRONG_DIAMETER = "wrong_diameter"
    THIN_COLUMN = "thin_column"
    """The drops do not spread through the measuring volume."""
    CAMERAS_SWAPPED = "cameras_swapped"
    CAMERA_OUT_OF_PLACE = "camera_out_of_place"
    # the solution
    NO_CAMERA = "no_camera"
    """The paper's method leads to a projection matrix that no camera has."""
    IMPLAUSIBLE_RIG = "implausible_rig"
    MANY_DROPS_LEFT_OUT = "many_drops_left_out"
    CAMERA_MOVED = "camera_moved"
    CAMERA_MOVED_DURING_DROPS = "camera_moved_during_drops"
    CAMERA_CONTRADICTS = "camera_contradicts"
    """Most views of a camera contradict the other cameras and were left out."""
    SCALE_NOT_OBSERVABLE = "scale_not_observable"
    FOCAL_LENGTH = "focal_length"
    FOCAL_LENGTH_OR_DIAMETER = "focal_length_or_diameter"
    OUT_OF_FOCUS = "out_of_focus"
    """A camera is sharpest beside the middle of the measuring volume."""
    LARGE_RESIDUAL = "large_residual"
    LARGE_HELD_OUT_RESIDUAL = "large_held_out_residual"
    UNCERTAIN_LENGTHS = "uncertain_lengths"
    LARGE_EDGE_OFFSET = "large_edge_offset"
    # a recalibration from stones
    TOO_FEW_STONES = "too_few_stones"
    UNKNOWN_CAMERA = "unknown_camera"
    CONTRADICTION = "contradiction"
    """A camera still contradicts the others afterwards."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationProblem:
    """One finding about a calibration; a fatal one forbids its use."""

    code: ProblemCode
    detail: str  # for people: what is wrong and the remedy
    camera: CameraId | None = None
    is_fatal: bool = True


class PipelineError(Exception):
    """Base class of the pipeline's errors."""


class RigError(PipelineError):
    """A rig document is damaged, incomplete or geometrically impossible.

    `field` is the path of the first wrong field, such as `cameras[3].K`, `problem` what is wrong with it.
    """

    def __init__(self, field: str, problem: str) -> None:
        super().__init__(field, problem)  # the arguments as given, since workers pickle errors
        self.field = field
        self.problem = problem

    @property
    def camera_index(self) -> int | None:
        """Index among the document's cameras of the one that the field belongs to; `None` of any other field."""
        entry = re.match(r"cameras\[(\d+)\]", self.field)
        return int(entry[1]) if entry else None

    def __str__(self) -> str:
        return f"{self.field}: {self.problem}"


class MeshError(PipelineError):
    """A mesh is not a closed, consistently oriented surface around a volume."""


class CalibrationError(PipelineError):
    """No calibration can be solved from these drops or stones; `problems` say why and what to do."""

    def __init__(self, problems: Sequence[CalibrationProblem]) -> None:
        super().__init__(tuple(problems))
        self.problems = tuple(problems)

    def __str__(self) -> str:
        return "; ".join(problem.detail for problem in self.problems if problem.is_fatal)


class ModelError(PipelineError):
    """A segmentation model is missing, damaged, another than expected, or of an unusable shape."""


class RejectedError(PipelineError):
    """A bundle shows no measurable stone; `detail` says why in words."""

    def __init__(self, reason: RejectReason, detail: str) -> None:
        super().__init__(f"{reason}: {detail}")
        self.reason = reason
        self.detail = detail
