"""What the pipeline refuses.

::

    PipelineError
    ├── RigError            a rig document that cannot be a rig; names the field
    ├── MeshError           a mesh that has no volume to measure; names the defect
    ├── CalibrationError    drops that no calibration can be made from; carries the problems
    ├── ModelError          a segmentation network that cannot be had or used; says what was expected
    └── RejectedError       this bundle shows no measurable stone; the reason becomes the outcome

Wrong arguments of a public function are plain `ValueError`.
"""

from collections.abc import Sequence
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pipeline.calibration.problem import Problem


class RejectReason(StrEnum):
    """Why a bundle ends as `rejected`. The word is part of the REST contract."""

    EMPTY = "empty"
    """Most views show the empty rig."""
    MULTIPLE = "multiple"
    """Several views show more than one body."""
    CLIPPED = "clipped"
    """The body leaves the image in several views, or the carved volume."""
    INSUFFICIENT_VIEWS = "insufficient_views"
    """Too few usable views, or a whole hemisphere of them is gone."""
    INCONSISTENT = "inconsistent"
    """More views contradict the others than may be dropped: not one rigid body seen at one instant."""
    NO_BACKGROUND = "no_background"
    """The empty rig was never seen, so nothing can be told from it."""
    IMPLAUSIBLE = "implausible"
    """The hull has no closed surface or no volume."""


class PipelineError(Exception):
    """Root of what the pipeline raises on purpose."""


class RigError(PipelineError):
    """A rig document is damaged, incomplete or geometrically impossible.

    `field` is the path of the first wrong field, such as `cameras[3].K`.
    """

    def __init__(self, field: str, problem: str) -> None:
        super().__init__(field, problem)  # as given: workers send errors home pickled
        self.field = field
        self.problem = problem

    def __str__(self) -> str:
        return f"{self.field}: {self.problem}"


class MeshError(PipelineError):
    """A mesh is not a closed, consistently oriented surface around a volume."""


class CalibrationError(PipelineError):
    """Nothing can be solved from these drops; `problems` say why and what to do."""

    def __init__(self, problems: "Sequence[Problem]") -> None:
        super().__init__(tuple(problems))
        self.problems = tuple(problems)

    def __str__(self) -> str:
        return "; ".join(problem.detail for problem in self.problems if problem.is_fatal)


class ModelError(PipelineError):
    """A segmentation model is missing, damaged, another than it claims to be, or of a shape nobody can use."""


class RejectedError(PipelineError):
    """No measurable stone in this bundle, for this reason."""

    def __init__(self, reason: RejectReason, detail: str) -> None:
        super().__init__(f"{reason}: {detail}")
        self.reason = reason
        self.detail = detail
