"""The report of a lot from the store, and the files of one that is closed, made in the process `stonefall-read`."""

import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from drivers.files.times import utc_now
from service.api.renditions import NotKeptError, preview_png
from service.api.version import API_VERSION
from service.base.errors import ServiceError, WorkerFailure
from service.base.language import Language
from service.delivery.file_drop import LotFiles
from service.delivery.settings import DropFormat
from service.lots.evaluation import lot_figures
from service.lots.figures import LotFigures
from service.lots.laboratory import StoredSieving, sievings
from service.lots.yardsticks import Request
from service.processing.worker_process import worker_boundary
from service.reports.render import render
from service.reports.report import (
    GalleryReason,
    GalleryStone,
    LaboratorySieving,
    LastVerification,
    ReportData,
    ReportFormat,
    SievingStep,
)
from service.store.particle_files import path_of
from service.store.reads import newest_folder
from service.store.schema import connect_reader

MATTER = {
    GalleryReason.HEAVIEST: ("volume_mm3 DESC", 3),
    GalleryReason.LARGEST: ("sieve_size_mm DESC", 2),
    GalleryReason.MOST_ELONGATED: ("max_feret_mm / min_feret_mm DESC", 2),
}
"""The order in which stones matter for a reason, and how many of them are shown."""
NEAREST = 2
"""Stones that are shown for being nearest to a sieve with limits."""


class FilesFailedError(ServiceError):
    """The files of a lot cannot be made."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportRequest:
    """Request for a report, with the facts that only the daemon knows of the rig."""

    figures: Request
    report_format: ReportFormat
    language: Language
    verification: LastVerification | None
    is_verification_overdue: bool


def lot_report(
    connection: sqlite3.Connection, particles_dir: Path, lot: str, wanted: ReportRequest
) -> bytes | None:
    """Return the report of a lot, None if there is none."""
    data = _report_data(connection, particles_dir, lot, wanted, has_pictures=True)
    return None if data is None else render(data, wanted.report_format)


def lot_files(
    path: Path, particles_dir: Path, lot: str, wanted: ReportRequest, formats: Sequence[DropFormat]
) -> LotFiles | None:
    """Return the files of a lot as it is at one moment, None if there is none.

    Raises
    ------
    FilesFailedError
        They cannot be made, for whatever reason.
    """
    try:
        with worker_boundary(), connect_reader(path) as connection:
            data = _report_data(
                connection, particles_dir, lot, wanted, has_pictures=DropFormat.PDF in formats
            )
            if data is None or data.figures.lot is None:
                return None
            content = {each: _file(data, each) for each in formats}
            return LotFiles(revision=data.figures.lot.revision, content=content)
    except WorkerFailure as failure:
        raise FilesFailedError(str(failure).strip().rpartition("\n")[2]) from None


def _file(data: ReportData, drop_format: DropFormat) -> bytes:
    if drop_format is DropFormat.JSON:
        return data.figures.model_dump_json().encode()
    return render(data, ReportFormat(drop_format))


def _report_data(
    connection: sqlite3.Connection,
    particles_dir: Path,
    lot: str,
    wanted: ReportRequest,
    *,
    has_pictures: bool,
) -> ReportData | None:
    """Return the contents of the report of a lot, None if there is no such lot."""
    figures = lot_figures(connection, lot, wanted.figures)
    if figures is None:
        return None
    limits_mm = [step.sieve_mm for step in figures.curve if step.decision is not None]
    return ReportData(
        figures=figures,
        created_at=utc_now(),
        language=wanted.language,
        software_version=metadata.version("stonefall"),
        api_version=API_VERSION,
        verification=wanted.verification,
        is_verification_overdue=wanted.is_verification_overdue,
        sievings=[_sieving(each, figures) for each in sievings(connection, lot)],
        gallery=_gallery(connection, particles_dir, lot, limits_mm) if has_pictures else (),
    )


def _gallery(
    connection: sqlite3.Connection, particles_dir: Path, lot: str, limits_mm: Sequence[float]
) -> list[GalleryStone]:
    """Return the stones that the figures depend on, each once with all its reasons."""
    nearest = " , ".join(f"abs(sieve_size_mm - {limit_mm})" for limit_mm in limits_mm)
    orders = dict(MATTER)
    if limits_mm:
        first = f"min({nearest})" if len(limits_mm) > 1 else nearest
        orders[GalleryReason.NEAREST_LIMIT] = (first, NEAREST)
    reasons: dict[int, list[GalleryReason]] = {}
    for reason, (order, n_stones) in orders.items():
        rows = connection.execute(
            f"SELECT seq FROM stones WHERE lot = ? AND outcome = 'measured' ORDER BY {order}, seq LIMIT ?",  # noqa: S608 - of this module and numbers
            (lot, n_stones),
        )
        for (seq,) in rows:
            reasons.setdefault(seq, []).append(reason)
    return [_stone(connection, particles_dir, seq, why) for seq, why in reasons.items()]


def _stone(
    connection: sqlite3.Connection, particles_dir: Path, seq: int, reasons: Sequence[GalleryReason]
) -> GalleryStone:
    name, size_mm, volume_mm3, quality = connection.execute(
        "SELECT id, sieve_size_mm, volume_mm3, quality FROM stones WHERE seq = ?", (seq,)
    ).fetchone()
    try:
        folder = newest_folder(connection, seq)
        png = None if folder is None else preview_png(path_of(particles_dir, folder))
    except NotKeptError:
        png = None
    return GalleryStone(
        id=name,
        reasons=reasons,
        sieve_size_mm=size_mm,
        volume_mm3=volume_mm3,
        quality=quality,
        preview_png=png,
    )


def _sieving(stored: StoredSieving, figures: LotFigures) -> LaboratorySieving:
    correlated = (
        {}
        if figures.correlated is None
        else {step.sieve_mm: step.passing_percent.value for step in figures.correlated.curve}
    )
    return LaboratorySieving(
        id=str(stored.sieving),
        at=stored.at,
        by=stored.document.by,
        steps=[
            SievingStep(
                sieve_mm=sieve_mm,
                passing_percent=percent,
                correlated_percent=correlated.get(sieve_mm),
            )
            for sieve_mm, percent in stored.document.passing_percent.items()
        ],
        correlation=None if figures.correlated is None else str(figures.correlated.version),
    )
