"""The states of a calibration, and which action leads from one to the next."""

from collections.abc import Mapping
from enum import StrEnum
from http import HTTPStatus

from service.base.errors import ProblemError, ProblemKind


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


TRANSITIONS: Mapping[tuple[CalibrationState, CalibrationAction], CalibrationState] = {
    (CalibrationState.COLLECTING, CalibrationAction.SOLVE): CalibrationState.SOLVING,
    (CalibrationState.SOLVING, CalibrationAction.SOLVE): CalibrationState.SOLVING,
    (CalibrationState.SOLVED, CalibrationAction.SOLVE): CalibrationState.SOLVING,
    (CalibrationState.SOLVED, CalibrationAction.ACCEPT): CalibrationState.ACCEPTED,
    (CalibrationState.ACCEPTED, CalibrationAction.ACCEPT): CalibrationState.ACCEPTED,
    (CalibrationState.SOLVED, CalibrationAction.REJECT): CalibrationState.REJECTED,
    (CalibrationState.REJECTED, CalibrationAction.REJECT): CalibrationState.REJECTED,
    (CalibrationState.COLLECTING, CalibrationAction.CANCEL): CalibrationState.CANCELLED,
    (CalibrationState.SOLVING, CalibrationAction.CANCEL): CalibrationState.CANCELLED,
    (CalibrationState.SOLVED, CalibrationAction.CANCEL): CalibrationState.CANCELLED,
    (CalibrationState.CANCELLED, CalibrationAction.CANCEL): CalibrationState.CANCELLED,
    (CalibrationState.ACCEPTED, CalibrationAction.ACTIVATE): CalibrationState.ACCEPTED,
}
"""State after a requested action; repeating a request changes nothing, an absent pair is a conflict. Not requested
are the transitions from `solving`: to `solved`, or back to `collecting` when there is no solution."""


class CalibrationConflictError(ProblemError):
    """The state of a calibration forbids a request; `state` is that state, None when it is not about one."""

    kinds = (
        ProblemKind("calibration-conflict", HTTPStatus.CONFLICT, "The calibration does not allow this now"),
    )

    def __init__(self, detail: str, *, state: CalibrationState | None = None) -> None:
        super().__init__(detail, state=state)


def next_state(name: str, current: CalibrationState, action: CalibrationAction) -> CalibrationState:
    """Return the state after `action`; raise `CalibrationConflictError` when `TRANSITIONS` has none."""
    try:
        return TRANSITIONS[current, action]
    except KeyError:
        possible = [str(known) for state, known in TRANSITIONS if state is current]
        raise CalibrationConflictError(
            f"calibration {name} is {current}: {action} is not possible, only {', '.join(possible) or 'nothing'}",
            state=current,
        ) from None
