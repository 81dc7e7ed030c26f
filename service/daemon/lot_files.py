"""The files of a closed lot for the drop folder, made in the process `stonefall-read`."""

from collections.abc import Sequence
from pathlib import Path

from service.base.errors import ServiceError, WorkerFailure
from service.delivery.file_drop import LotFiles, MakeFiles
from service.delivery.settings import DropFormat, FileDropSettings
from service.lots.shifts import LotsSettings
from service.lots.yardsticks import Request
from service.processing.worker_process import worker_boundary
from service.reports.lot_reports import RENDERERS, ReportRequest, RigStanding, report_data
from service.reports.report import ReportFormat
from service.store import Store
from service.store.schema import connect_reader
from service.web.control import Control
from service.web.reader_process import Reading


class FilesFailedError(ServiceError):
    """The files of a lot cannot be made."""


def files_maker(store: Store, control: Control, reading: Reading) -> MakeFiles:
    """Return the function that makes the files of a lot in the reading process."""

    async def make_files(lot: str, settings: FileDropSettings) -> LotFiles | None:
        wanted = ReportRequest(
            figures=Request(measured=control.part(LotsSettings).measured),
            language=settings.language,
            rig=control.part(RigStanding),
        )
        return await reading.run(lot_files, store.path, store.particles_dir, lot, wanted, settings.formats)

    return make_files


def lot_files(
    path: Path, particles_dir: Path, lot: str, wanted: ReportRequest, formats: Sequence[DropFormat]
) -> LotFiles | None:
    """Return the files of a lot as it is at one moment, None if there is none.

    Raises `FilesFailedError` when they cannot be made, for whatever reason.
    """
    try:
        with worker_boundary(), connect_reader(path) as connection:
            data = report_data(connection, particles_dir, lot, wanted, has_pictures=DropFormat.PDF in formats)
            if data is None or data.figures.lot is None:
                return None
            content = {
                each: data.figures.model_dump_json().encode()
                if each is DropFormat.JSON
                else RENDERERS[ReportFormat(each)](data)
                for each in formats
            }
            return LotFiles(revision=data.figures.lot.revision, content=content)
    except WorkerFailure as failure:
        raise FilesFailedError(str(failure).strip().rpartition("\n")[2]) from None
