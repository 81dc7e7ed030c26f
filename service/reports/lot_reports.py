"""Reports and curves of lots and of times from the store, made in the process `stonefall-read`."""

import sqlite3
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path

from drivers.files.times import utc_now
from pipeline.preview import THUMBNAIL_PX
from service.base.csv_text import STYLES
from service.base.language import Language
from service.lots.evaluation import lot_figures, passing_of, window_figures
from service.lots.figures import LotFigures
from service.lots.laboratory import valid_sievings
from service.lots.plant import PlantSettings, logo_of
from service.lots.stones import Choice, stones_of_lot
from service.lots.yardsticks import Request
from service.particles.renditions import NotKeptError, stone_png
from service.reports.csv_file import render_csv
from service.reports.curve import Beside, curve_svg
from service.reports.drawing import Canvas
from service.reports.printed import render_html, render_pdf
from service.reports.report import EndedVerification, GalleryReason, GalleryStone, ReportData, ReportFormat
from service.reports.words import words
from service.reports.workbook import render_xlsx
from service.store.particle_files import path_of
from service.store.reads import newest_folder
from service.web.version import API_VERSION

RENDERERS: Mapping[ReportFormat, Callable[[ReportData], bytes]] = {
    ReportFormat.HTML: render_html,
    ReportFormat.PDF: render_pdf,
    ReportFormat.CSV: render_csv,
    ReportFormat.XLSX: render_xlsx,
}
"""Functions from the data of a report to its file; the same data gives the same bytes."""
ISSUED = "issued"
"""Folder of the store with the issued reports, as `LOT-REVISION.pdf`."""
MATTER = {
    GalleryReason.HEAVIEST: ("volume_mm3 DESC", 3),
    GalleryReason.LARGEST: ("sieve_size_mm DESC", 2),
    GalleryReason.MOST_ELONGATED: ("max_feret_mm / min_feret_mm DESC", 2),
}
"""The order in which stones matter for a reason, and how many of them are shown."""
NEAREST = 2
"""Stones that are shown for being nearest to a sieve with limits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RigStanding:
    """Facts about rig and plant that a report states: the last verification, and whether another one is overdue."""

    verification: EndedVerification | None
    is_overdue: bool  # False where the configuration asks for none
    plant: PlantSettings = field(default_factory=PlantSettings)
    density_kg_m3: float | None = None  # of stones in no lot


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportRequest:
    """Request for a report."""

    figures: Request
    language: Language
    rig: RigStanding


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveRequest:
    """How a curve is to be drawn, and what beside it."""

    figures: Request
    look: Canvas
    beside_lot: str | None = None
    beside_algorithm_version: str | None = None


def lot_report(
    connection: sqlite3.Connection,
    particles_dir: Path,
    lot: str,
    wanted: ReportRequest,
    report_format: ReportFormat,
) -> bytes | None:
    """Return the report of a lot, None if there is none; CSV as spreadsheets of the language read it."""
    has_pictures = report_format is ReportFormat.HTML
    data = report_data(connection, particles_dir, lot, wanted, has_pictures=has_pictures)
    if data is None:
        return None
    if report_format is ReportFormat.CSV:
        return render_csv(data, STYLES[wanted.language])
    return RENDERERS[report_format](data)


def issued_report(store_dir: Path, lot: str, revision: int) -> bytes | None:
    """Return the report that was issued for a revision of a lot, None if there is none; blocks."""
    try:
        return (store_dir / ISSUED / f"{lot}-{revision}.pdf").read_bytes()
    except FileNotFoundError:
        return None


def report_data(
    connection: sqlite3.Connection,
    particles_dir: Path,
    lot: str,
    wanted: ReportRequest,
    *,
    has_pictures: bool,
    signer: str | None = None,
) -> ReportData | None:
    """Return the contents of the report of a lot, None if there is no such lot; `signer`: see `ReportData`."""
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
        verification=wanted.rig.verification,
        is_verification_overdue=wanted.rig.is_overdue,
        sievings=valid_sievings(connection, lot),
        gallery=_gallery(connection, particles_dir, lot, limits_mm) if has_pictures else (),
        plant=wanted.rig.plant,
        logo_svg=logo_svg(wanted.rig.plant),
        signer=signer,
    )


def logo_svg(plant: PlantSettings) -> str | None:
    """Return the logo, None if there is none, or none any more: a report does without."""
    with suppress(ValueError):
        return None if plant.logo is None else logo_of(plant.logo)
    return None


def _gallery(
    connection: sqlite3.Connection, particles_dir: Path, lot: str, limits_mm: Sequence[float]
) -> list[GalleryStone]:
    """Return the stones that the figures depend on, each once with all its reasons."""
    nearest = " , ".join(f"abs(sieve_size_mm - {limit_mm})" for limit_mm in limits_mm)
    orders = dict(MATTER)
    if limits_mm:
        first = f"min({nearest})" if len(limits_mm) > 1 else nearest
        orders[GalleryReason.NEAREST_LIMIT] = (first, NEAREST)
    reasons: dict[tuple[int, str, float, float, str], list[GalleryReason]] = {}
    for reason, (order, n_stones) in orders.items():
        rows = connection.execute(
            "SELECT seq, id, sieve_size_mm, volume_mm3, quality FROM stones"  # noqa: S608 - of this module and numbers
            f" WHERE lot = ? AND outcome = 'measured' ORDER BY {order}, seq LIMIT ?",
            (lot, n_stones),
        )
        for row in rows:
            reasons.setdefault(row, []).append(reason)
    return [
        GalleryStone(
            id=name,
            reasons=why,
            sieve_size_mm=size_mm,
            volume_mm3=volume_mm3,
            quality=quality,
            preview_png=_preview(connection, particles_dir, seq),
        )
        for (seq, name, size_mm, volume_mm3, quality), why in reasons.items()
    ]


def _preview(connection: sqlite3.Connection, particles_dir: Path, seq: int) -> bytes | None:
    folder = newest_folder(connection, seq)
    with suppress(NotKeptError):
        return None if folder is None else stone_png(path_of(particles_dir, folder), THUMBNAIL_PX)
    return None


def lot_curve_svg(
    connection: sqlite3.Connection, lot: str, choice: Choice, wanted: CurveRequest
) -> str | None:
    """Return the curve of a lot, or of a choice of its stones, as the report draws it; None if there is none."""
    figures = lot_figures(connection, lot, wanted.figures, choice)
    if figures is None:
        return None
    return _curve_svg(
        connection, figures, _name(lot, choice.algorithm_version, wanted.look.language), lot, wanted
    )


def window_curve_svg(
    connection: sqlite3.Connection,
    since: str,
    until: str,
    product: str | None,
    name: str,
    wanted: CurveRequest,
) -> str | None:
    """Return the curve of what fell within a time, None if the product is unknown; `name` is that of the time."""
    figures = window_figures(connection, since, until, wanted.figures, product)
    return None if figures is None else _curve_svg(connection, figures, name, None, wanted)


def _curve_svg(
    connection: sqlite3.Connection, figures: LotFigures, name: str, lot: str | None, wanted: CurveRequest
) -> str:
    """Return the curve with the one beside it; without `beside_lot` that is of the same lot."""
    version, beside = wanted.beside_algorithm_version, None
    other = wanted.beside_lot or (lot if version else None)
    if other is not None:
        beside = Beside(
            first_name=name,
            name=_name(other, version, wanted.look.language),
            passing_percent=passing_of(
                stones_of_lot(connection, other, Choice(algorithm_version=version)).lot,
                [step.sieve_mm for step in figures.curve],
                wanted.figures.measured,
            ),
        )
    return curve_svg(figures.curve, wanted.look, beside=beside)


def _name(lot: str, algorithm_version: str | None, language: Language) -> str:
    if algorithm_version is None:
        return lot
    return words(language)("curve.by_version", name=lot, version=algorithm_version)
