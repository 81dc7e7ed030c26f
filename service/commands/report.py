"""`stonefall report`: the report of offline results, as of a lot; the check of a signed one."""

import re
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

import typer

from drivers.files.bounded import read_bounded
from drivers.files.durable import write_file
from drivers.files.times import utc_now
from service.base.errors import ServiceError, UsageError
from service.base.language import Language
from service.commands.daemon_client import DEFAULT_URL, DaemonClient, Url
from service.commands.options import SizeOptions, with_options
from service.commands.results_folder import read_results
from service.configuration.settings import load_settings
from service.lots.evaluation import figures_of
from service.lots.products import Product
from service.lots.stones import stones_in
from service.lots.yardsticks import Request, UnknownYardstickError
from service.reports.lot_reports import RENDERERS
from service.reports.report import ReportData, ReportFormat
from service.reports.signatures import (
    MAX_KEY_BYTES,
    MAX_REPORT_BYTES,
    SignatureState,
    checked,
    fingerprint_of,
    grouped,
    known_fingerprints,
)
from service.web.version import API_VERSION

NAMED_SHIFTS = ("now", "last")
"""Words for the two newest shifts, in their order."""


@dataclass(frozen=True, slots=True)
class ReportedProduct(SizeOptions):
    """Options of `stonefall report` that define the product."""

    title: Annotated[str, typer.Option(help="Name of the product.")] = "offline results"
    density_kg_m3: Annotated[float, typer.Option(help="Density of the particles, kg/m3.")] = 2700.0
    sieve_set: Annotated[str, typer.Option("--sieves", help="Name of a sieve set.")] = "stonefall"


@dataclass(frozen=True, slots=True)
class CheckedReport:
    """Options of the check of a signed report."""

    verify: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Check the signature of this PDF instead.")
    ] = None
    key: Annotated[
        str | None,
        typer.Option(
            help="With --verify: the instrument's key: its fingerprint, the public key, or a file with the answer of"
            " GET /instrument/key."
        ),
    ] = None
    config: Annotated[
        Path | None, typer.Option(help="With --verify: TOML file of the daemon, whose keys are relied on.")
    ] = None


@dataclass(frozen=True, slots=True)
class WantedSheet:
    """Options of the sheet of a shift."""

    shift: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Write the sheet of this shift of a running daemon instead, PDF and HTML: 2026-03-02-0600, `now`, or"
            " `last` for the one that has ended.",
        ),
    ] = None
    url: Url = DEFAULT_URL
    token: Annotated[
        str | None,
        typer.Option(help="With --shift: token of a key.", envvar="STONEFALL_KEY", show_envvar=True),
    ] = None


@with_options
def command(
    product: ReportedProduct,
    results: Annotated[
        Path | None, typer.Argument(metavar="RESULTS", help="Folder that `stonefall measure` wrote.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for report.html, .pdf, .csv and .xlsx.")] = None,
    language: Annotated[Language, typer.Option(help="Language of the report.")] = Language.ENGLISH,
    *,
    checked_report: CheckedReport,
    sheet: WantedSheet,
) -> None:
    """Write the report of measured results: curve with its interval, indices, verdict, accounting.

    With --shift: write the sheet of a shift. With --verify: check a report that an instrument signed, and exit with 1
    unless a key that is known signed it.
    """
    if sheet.shift is not None:
        _write_sheet(DaemonClient(sheet.url, sheet.token), sheet.shift, out, language)
        return
    if checked_report.verify is not None:
        _verify(checked_report.verify, checked_report.key, checked_report.config)
        return
    if results is None or out is None:
        raise UsageError("RESULTS and --out are needed, or --shift NAME, or --verify FILE")
    defined = Product(product=product.title, version=1, created_at=utc_now(), **asdict(product))
    try:
        figures = figures_of(stones_in(read_results(results)), Request(), defined)
    except UnknownYardstickError as err:
        raise UsageError(str(err)) from err
    data = ReportData(
        figures=figures,
        created_at=utc_now(),
        language=language,
        software_version=metadata.version("stonefall"),
        api_version=API_VERSION,
    )
    try:
        out.mkdir(parents=True, exist_ok=True)
        for report_format in ReportFormat:
            write_file(out / f"report.{report_format}", RENDERERS[report_format](data))
    except OSError as err:
        raise ServiceError(f"--out {out}: {err.strerror}") from err
    verdict = "" if figures.verdict is None else f": {figures.verdict.replace('_', ' ')}"
    typer.echo(f"{out}: report of {figures.measured} stones{verdict}")


def _write_sheet(daemon: DaemonClient, shift: str, out: Path | None, language: Language) -> None:
    """Write the sheet of a shift into a folder."""
    if out is None:
        raise UsageError("--out is needed with --shift")
    if shift in NAMED_SHIFTS:
        shift = daemon.ask("/shifts?limit=2")["items"][NAMED_SHIFTS.index(shift)]["shift"]
    for kind in ("html", "pdf"):
        content = daemon.fetch(f"/shifts/{quote(shift, safe='')}/sheet.{kind}?language={language}")
        try:
            out.mkdir(parents=True, exist_ok=True)
            write_file(out / f"shift-{shift}.{kind}", content)
        except OSError as err:
            raise ServiceError(f"--out {out}: {err.strerror}") from err
    typer.echo(f"{out}: sheet of the shift {shift}")


def _verify(file: Path, key: str | None, config: Path | None) -> None:
    """Print what the signature of a report proves; raise `ServiceError` unless a key that is relied on signed it."""
    known = set() if config is None else known_fingerprints(load_settings(config).store.dir)
    if key is not None:
        known.add(_fingerprint(key))
    try:
        found = checked(read_bounded(file, MAX_REPORT_BYTES), known)
    except OSError as err:
        raise ServiceError(f"{file}: {err.strerror}") from err
    if found.state is SignatureState.UNKNOWN_KEY and known:
        raise ServiceError(
            f"{file}: signed by another key, {found.fingerprint}, not by {', '.join(sorted(known))}"
        )
    if found.state is not SignatureState.GENUINE:
        raise ServiceError(f"{file}: {found.detail}")
    typer.echo(f"{file}: {found.detail}")


def _fingerprint(key: str) -> str:
    """Return the fingerprint that a text or a file names; raise `UsageError` for another one."""
    path = Path(key)
    text = read_bounded(path, MAX_KEY_BYTES).decode(errors="replace") if path.is_file() else key
    public = re.search(r"\b[0-9a-f]{64}\b", text)
    if public is not None:
        return fingerprint_of(public[0])
    digits = re.sub(r"[\s:-]", "", text.lower())
    if not re.fullmatch(r"[0-9a-f]{32}", digits):
        raise UsageError(f"--key {key}: is no fingerprint, no public key and no file with one")
    return grouped(digits)
