"""The request for a calibration, its states, and which action leads from one to the next."""

from collections.abc import Collection, Mapping
from enum import StrEnum
from http import HTTPStatus
from typing import Annotated

from pydantic import Field

from service.base.errors import ProblemError, ProblemKind
from service.base.schema import Name, Remark, request_body

BALL_DIAMETERS_MM = (1.0, 45.0)
"""Range of diameters that the cameras resolve and that fit into their images."""
# strict: `true` is no number; a whole number is one of millimetres all the same
DiameterMm = Annotated[float, Field(ge=BALL_DIAMETERS_MM[0], le=BALL_DIAMETERS_MM[1], strict=True)]
MIN_SIZE_RATIO = 1.2
"""Least ratio of two diameters: balls closer in size cannot be told apart before the rig is calibrated."""


class Method(StrEnum):
    """Method of calibration."""

    BUNDLE = "bundle"
    """Bundle adjustment of all cameras and balls."""
    PAPER = "paper"
    """Algorithm 1 of the paper."""
    STONES = "stones"
    """New poses for cameras that moved, from any stones, without a ball."""


@request_body
class CalibrationRequest:
    """Request for a calibration. Everything that falls from now on is observed."""

    ball_diameters_mm: Annotated[tuple[DiameterMm, ...], Field(max_length=2)] = ()
    """Diameter of the ball, mm. Two diameters that differ by a fifth or more also reveal outlines that are
    too large or too small. Empty with `stones`."""
    method: Method = Method.BUNDLE
    """`bundle`: bundle adjustment of all cameras and balls; `paper`: Algorithm 1 of the paper; `stones`: new
    poses for cameras that moved, from any stones, without a ball."""
    note: Remark | None = None
    """Kept with it."""
    by: Name | None = None
    """Who calibrates."""

    def __post_init__(self) -> None:
        n_needed = (0,) if self.method is Method.STONES else (1, 2)
        if len(self.ball_diameters_mm) not in n_needed:
            raise ValueError(
                f"ball_diameters_mm: method {self.method} takes {' or '.join(map(str, n_needed))} diameters,"
                f" not {len(self.ball_diameters_mm)}"
            )
        if len(self.ball_diameters_mm) == 2:
            small_mm, large_mm = sorted(self.ball_diameters_mm)
            if large_mm < MIN_SIZE_RATIO * small_mm:
                raise ValueError(
                    f"ball_diameters_mm: {small_mm:g} and {large_mm:g} cannot be told apart before the rig is"
                    f" calibrated: take balls that differ by a factor of {MIN_SIZE_RATIO:g} or more"
                )


class CalibrationState(StrEnum):
    """State of a calibration."""

    COLLECTING = "collecting"
    """Open: every drop is observed."""
    SOLVING = "solving"
    """Open: the rig is being computed from the drops so far."""
    SOLVED = "solved"
    """Open: there is a report to review; drops are still observed, for another solution."""
    ACCEPTED = "accepted"
    """A version: it can be activated, now and at any later time."""
    REJECTED = "rejected"
    CANCELLED = "cancelled"


OPEN = frozenset({CalibrationState.COLLECTING, CalibrationState.SOLVING, CalibrationState.SOLVED})
"""States of an open calibration, which collects drops. At most one calibration is open."""


class CalibrationAction(StrEnum):
    """Action that can be requested."""

    SOLVE = "solve"
    ACCEPT = "accept"
    REJECT = "reject"
    CANCEL = "cancel"
    ACTIVATE = "activate"


TRANSITIONS: Mapping[CalibrationAction, tuple[Collection[CalibrationState], CalibrationState]] = {
    CalibrationAction.SOLVE: (OPEN, CalibrationState.SOLVING),
    CalibrationAction.ACCEPT: ([CalibrationState.SOLVED], CalibrationState.ACCEPTED),
    CalibrationAction.REJECT: ([CalibrationState.SOLVED], CalibrationState.REJECTED),
    CalibrationAction.CANCEL: (OPEN, CalibrationState.CANCELLED),
    CalibrationAction.ACTIVATE: ([CalibrationState.ACCEPTED], CalibrationState.ACCEPTED),
}
"""By action the states that allow it, and the state after it, which allows it as well: repeating a request changes
nothing. Not requested are the transitions from `solving`: to `solved`, or back to `collecting` without a solution."""


class CalibrationConflictError(ProblemError):
    """The state of a calibration forbids a request; `state` is that state, None when it is not about one."""

    kinds = (
        ProblemKind("calibration-conflict", HTTPStatus.CONFLICT, "The calibration does not allow this now"),
    )

    def __init__(self, detail: str, *, state: CalibrationState | None = None) -> None:
        super().__init__(detail, state=state)


def next_state(name: str, current: CalibrationState, action: CalibrationAction) -> CalibrationState:
    """Return the state after `action`; raise `CalibrationConflictError` where `TRANSITIONS` has none."""
    possible = [known for known, (states, after) in TRANSITIONS.items() if current in (*states, after)]
    if action in possible:
        return TRANSITIONS[action][1]
    detail = f"{action} is not possible, only {', '.join(possible) or 'nothing'}"
    raise CalibrationConflictError(f"calibration {name} is {current}: {detail}", state=current)
