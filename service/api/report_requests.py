"""What only the daemon knows of the report of a lot, added to what was asked for."""

from service.api.control import Control
from service.api.lot_reports import ReportRequest, lot_files
from service.api.reader_process import Reading
from service.base.language import Language
from service.calibration.verifications import Verification, VerificationState
from service.delivery.file_drop import LotFiles, MakeFiles
from service.delivery.settings import FileDropSettings
from service.lots.yardsticks import Request
from service.reports.report import LastVerification, ReportFormat, VerificationOutcome
from service.results.fields import Verified
from service.store import Store


def report_request(
    control: Control, figures: Request, report_format: ReportFormat, language: Language
) -> ReportRequest:
    """Return the request for a report, with what the rig's last verification says."""
    calibrations = control.calibrations
    last = calibrations.verifications.last(calibrations.rig_file.calibration_id)
    return ReportRequest(
        figures=figures,
        report_format=report_format,
        language=language,
        verification=None if last is None else _last_verification(last),
        is_verification_overdue=calibrations.verified is Verified.OVERDUE,
    )


def files_maker(store: Store, control: Control, reading: Reading) -> MakeFiles:
    """Return the function that makes the files of a lot in the reading process."""

    async def make_files(lot: str, settings: FileDropSettings) -> LotFiles | None:
        figures = Request(measured=control.lots.measured)
        wanted = report_request(control, figures, ReportFormat.CSV, settings.language)
        return await reading.run(lot_files, store.path, store.particles_dir, lot, wanted, settings.formats)

    return make_files


def _last_verification(last: Verification) -> LastVerification:
    passed = last.state is VerificationState.PASSED
    return LastVerification(
        id=last.id,
        at=last.changed_at,
        outcome=VerificationOutcome.PASSED if passed else VerificationOutcome.FAILED,
        diameter_mm=last.diameter_mm,
        error_mm=None if last.summary is None else last.summary.error_mm,
    )
