"""`stonefall report`: the report of offline results, as of a lot."""

from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Annotated

import typer

from drivers.files.durable import write_file
from drivers.files.times import utc_now
from service.base.errors import ServiceError, UsageError
from service.base.language import Language
from service.commands.options import SizeOptions, with_options
from service.commands.results_folder import read_results
from service.lots.evaluation import figures_of
from service.lots.products import Product
from service.lots.stones import stones_in
from service.lots.yardsticks import Request, UnknownYardstickError
from service.reports.lot_reports import RENDERERS
from service.reports.report import ReportData, ReportFormat
from service.web.version import API_VERSION


@dataclass(frozen=True, slots=True)
class ReportedProduct(SizeOptions):
    """Options of `stonefall report` that define the product."""

    title: Annotated[str, typer.Option(help="Name of the product.")] = "offline results"
    density_kg_m3: Annotated[float, typer.Option(help="Density of the particles, kg/m3.")] = 2700.0
    sieve_set: Annotated[str, typer.Option("--sieves", help="Name of a sieve set.")] = "stonefall"


@with_options
def command(
    results: Annotated[
        Path, typer.Argument(metavar="RESULTS", help="Folder that `stonefall measure` wrote.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for report.html, .pdf, .csv and .xlsx.")],
    product: ReportedProduct,
    language: Annotated[Language, typer.Option(help="Language of the report.")] = Language.ENGLISH,
) -> None:
    """Write the report of measured results: curve with its interval, indices, verdict, accounting."""
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
