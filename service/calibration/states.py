"""What may be done with a calibration, and when: one table, no exceptions to it."""

from collections.abc import Mapping
from enum import StrEnum

from service.errors import ServiceError


class CalibrationState(StrEnum):
    """Where a calibration stands between the first ball and its use."""

    COLLECTING = "collecting"
    """Every ball that falls is observed."""
    SOLVING = "solving"
    SOLVED = "solved"
    """There is a report to review; balls are still observed, for another try."""
    ACCEPTED = "accepted"
    """A version: it can be activated, now and at any later time."""
    REJECTED = "rejected"
    CANCELLED = "cancelled"


OPEN = frozenset({CalibrationState.COLLECTING, CalibrationState.SOLVING, CalibrationState.SOLVED})
"""The session goes on; what falls is a ball. There is at most one such calibration."""


class CalibrationAction(StrEnum):
    """What people ask for."""

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
"""The state that follows a request; asking again changes nothing. A pair that is absent is a conflict. A solution
leads from `solving` to `solved`, its failure back to `collecting`: nobody asks for these."""


class CalibrationConflictError(ServiceError):
    """What was asked for cannot be done now; `state` is that of the calibration it is about, if there is one."""

    def __init__(self, detail: str, *, state: CalibrationState | None = None) -> None:
        super().__init__(detail)
        self.state = state


def next_state(name: str, current: CalibrationState, action: CalibrationAction) -> CalibrationState:
    """Return the state after `action`; raise `CalibrationConflictError` where the table has no answer."""
    try:
        return TRANSITIONS[current, action]
    except KeyError:
        possible = [str(known) for state, known in TRANSITIONS if state is current]
        raise CalibrationConflictError(
            f"calibration {name} is {current}: {action} is not possible, only {', '.join(possible) or 'nothing'}",
            state=current,
        ) from None
