"""The rig's last verification, as reports state it."""

from service.calibration.calibrations import Calibrations
from service.calibration.verifications import VerificationState
from service.reports.lot_reports import RigStanding
from service.reports.report import LastVerification, VerificationOutcome
from service.results.fields import Verified


def rig_standing(calibrations: Calibrations) -> RigStanding:
    """Return the last verification of the rig file in use, and whether another one is overdue."""
    last = calibrations.verifications.last(calibrations.rig_file.calibration_id)
    return RigStanding(
        verification=None
        if last is None
        else LastVerification(
            id=last.id,
            at=last.changed_at,
            outcome=VerificationOutcome.PASSED
            if last.state is VerificationState.PASSED
            else VerificationOutcome.FAILED,
            diameter_mm=last.diameter_mm,
            error_mm=None if last.summary is None else last.summary.error_mm,
        ),
        is_overdue=calibrations.verified is Verified.OVERDUE,
    )
