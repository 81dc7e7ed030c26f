"""The files of a closed lot, for the drop folder and as its issued report, made in the process `stonefall-read`."""

import hashlib
import logging
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from sqlite3 import Connection

from drivers.files.times import utc_now
from service.base.errors import ServiceError, StoreError, WorkerFailure
from service.delivery.file_drop import FileDrop, LotFiles, MakeFiles, Purpose
from service.delivery.settings import DropFormat, FileDropSettings
from service.lots.lots import complete_lot, existing_lot, uncompleted_lots
from service.lots.outcome import LotCompletion, LotOutcome
from service.lots.products import find_product
from service.lots.shifts import LotsSettings
from service.lots.trends.control import followed_figures, product_drift
from service.lots.yardsticks import Request
from service.processing.worker_process import worker_boundary
from service.reports.lot_reports import ISSUED, RENDERERS, ReportRequest, RigStanding, report_data
from service.reports.report import ReportFormat
from service.reports.signatures import instrument_key, note_key, signed
from service.store import Store
from service.store.events import EventType, NewEvent, note_event
from service.store.schema import connect_reader
from service.web.control import Control
from service.web.reader_process import Reading
from service.web.version import BASE

log = logging.getLogger(__name__)


class FilesFailedError(ServiceError):
    """The files of a lot cannot be made."""


def files_maker(store: Store, control: Control, reading: Reading) -> MakeFiles:
    """Return the function that makes the files of a lot in the reading process."""

    async def make_files(lot: str, settings: FileDropSettings) -> LotFiles | None:
        lots = control.part(LotsSettings)
        wanted = ReportRequest(
            figures=Request(measured=lots.measured),
            language=settings.language or lots.report_language,
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
            key = instrument_key(path.parent) if DropFormat.PDF in formats else None
            signer = None if key is None else key.fingerprint
            data = report_data(connection, particles_dir, lot, wanted, has_pictures=False, signer=signer)
            if data is None or data.figures.lot is None:
                return None
            content = {
                each: data.figures.model_dump_json().encode()
                if each is DropFormat.JSON
                else RENDERERS[ReportFormat(each)](data)
                for each in formats
            }
            record = data.figures.lot
            if key is not None:
                content[DropFormat.PDF] = signed(
                    content[DropFormat.PDF],
                    key,
                    instrument=wanted.rig.plant.instrument_serial,
                    lot=lot,
                    revision=record.revision,
                    signed_at=data.created_at,
                )
            product = find_product(connection, record.product, record.product_version)
            figures = {} if product is None else followed_figures(data.figures, product)
            return LotFiles(
                revision=record.revision,
                content=content,
                outcome={name: getattr(data.figures, name) for name in LotOutcome.model_fields},
                figures={name: asdict(figure) for name, figure in figures.items()},
            )
    except WorkerFailure as failure:
        raise FilesFailedError(str(failure).strip().rpartition("\n")[2]) from None


def issued_reports(store: Store) -> FileDrop:
    """Return the writer of the report of each revision of a closed lot, which is completed by it.

    The key that signs them is made with the first start; what is wrong with it keeps lots from being completed, not the
    daemon from measuring.
    """
    folder = store.dir / ISSUED
    folder.mkdir(exist_ok=True)
    try:
        instrument_key(store.dir)
    except StoreError as err:
        log.error("no report can be signed: %s", err)
    wanted = FileDropSettings(dir=folder, formats=(DropFormat.PDF,))
    return FileDrop(
        store,
        wanted,
        Purpose(check="issued_reports", due=uncompleted_lots, note=partial(note_issued, store.dir)),
    )


def note_issued(state_dir: Path, connection: Connection, lot: str, files: LotFiles) -> None:
    """Complete a revision of a lot within a transaction: its report is durable. Its product may drift with it.

    The key that signed the report is noted.
    """
    note_key(connection, instrument_key(state_dir).public_key)
    if files.revision is None:
        return
    completion = LotCompletion(
        **files.outcome,
        revision=files.revision,
        at=utc_now(),
        report=f"{BASE}/lots/{lot}/report.pdf?revision={files.revision}",
        report_sha256=hashlib.sha256(files.content[DropFormat.PDF]).hexdigest(),
    )
    product = existing_lot(connection, lot).product
    was_drifting = product_drift(connection, product) is not None
    complete_lot(connection, lot, completion, files.figures)
    drift = product_drift(connection, product)
    if drift is not None and not was_drifting:
        event = EventType.PRODUCT_DRIFTING
        note_event(connection, NewEvent(type=event, subject=product, data=drift.model_dump()))
