"""`stonefall fit-volume`: fit the volume correction to stones that were measured and weighed."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from drivers.files.bounded import read_bounded
from drivers.files.durable import MAX_JSON_BYTES
from pipeline.measuring.volume_correction import fit_volume_model
from service.base.errors import UsageError, VolumeModelError
from service.base.tables.files import NamedColumn, read_rows
from service.base.tables.lines import TableError, text_of
from service.base.tables.numbers import Limits, cell_of, numbers_of
from service.commands.options import DensityOptions, with_options
from service.configuration.volume_models import write_volume_model
from service.results.fields import Outcome

FIELDS = ("volume_raw_mm3", "volume_estimate_mm3")
COLUMNS = {
    "bundle": NamedColumn(("bundle", "bündel")),
    "mass_g": NamedColumn(("mass", "masse", "weight", "gewicht"), usual_unit="g"),
}
MOST_OFF = 5.0
"""Factor by which a mass may differ from that of the measured volume: other units are further off."""
MAX_VOLUME_MM3 = 1e6
"""Volume of a cube of 100 mm, which is larger than the field of view."""


@with_options
def command(
    results: Annotated[Path, typer.Argument(help="results.jsonl of `stonefall measure`.")],
    weighed: Annotated[Path, typer.Argument(help="Table with the columns bundle and mass_g: CSV or XLSX.")],
    out: Annotated[
        Path, typer.Option(help="File to write, for [measuring] volume_model of the configuration.")
    ],
    density: DensityOptions,
    as_json: Annotated[bool, typer.Option("--json", help="Print the coefficients as JSON.")] = False,
) -> None:
    """Fit the volume correction to weighed stones.

    A stone may have been measured several times, each with a line of its own.
    """
    density_kg_m3 = density.given_kg_m3
    if density_kg_m3 is None:
        raise UsageError("--density-kg-m3 is missing: what the stones were weighed for")
    measured = _measured(results)
    masses_g = _masses_g(weighed, results, measured, density_kg_m3)
    hull_mm3 = [measured[bundle][0] for bundle in masses_g]
    estimate_mm3 = [measured[bundle][1] for bundle in masses_g]
    true_mm3 = [1e6 * mass_g / density_kg_m3 for mass_g in masses_g.values()]
    try:
        model = fit_volume_model(out.stem, hull_mm3, estimate_mm3, true_mm3)
    except ValueError as err:
        raise VolumeModelError(f"{weighed}: {err}") from err
    fitted_mm3 = [model.volume_mm3(*volumes) for volumes in zip(hull_mm3, estimate_mm3, strict=True)]
    rms_percent = 100 * float(np.sqrt(np.mean((np.array(fitted_mm3) / true_mm3 - 1) ** 2)))
    summary: dict[str, float | int | str] = {
        "n_stones": len(masses_g),
        "density_kg_m3": density_kg_m3,
        "rms_percent": round(rms_percent, 3),
    }
    write_volume_model(out, model, summary)
    found = {"id": model.id, "gap_share": model.gap_share, "hidden_share": model.hidden_share, **summary}
    if as_json:
        typer.echo(json.dumps(found))
    else:
        typer.echo(
            f"{out}: gap_share {model.gap_share:.3f}, hidden_share {100 * model.hidden_share:.2f} %;"
            f" {len(masses_g)} stones fit within {rms_percent:.2f} % rms"
        )


def _measured(path: Path) -> dict[str, tuple[float, float]]:
    """Return the volumes of hull and estimate, mm³, of the measured stones by bundle."""
    volumes_mm3: dict[str, tuple[float, float]] = {}
    try:
        content = read_bounded(path, MAX_JSON_BYTES)
    except OSError as err:
        raise VolumeModelError(f"{path}: cannot be read: {err.strerror}") from err
    for number, line in enumerate(text_of(content).splitlines(), start=1):
        where = f"{path}: line {number}"
        try:
            record = json.loads(line)
            bundle, is_measured = str(record["bundle"]), record["outcome"] == Outcome.MEASURED
        except (ValueError, LookupError, TypeError, RecursionError) as err:
            raise VolumeModelError(f"{where}: is not a result of stonefall measure") from err
        if is_measured:
            for field in FIELDS:
                found = record.get(field)
                if not (isinstance(found, int | float) and 0 < found < MAX_VOLUME_MM3):
                    raise VolumeModelError(f"{where}: has no {field}; measure the recording again")
            hull_mm3, estimate_mm3 = (float(record[field]) for field in FIELDS)
            volumes_mm3[bundle] = hull_mm3, estimate_mm3
    return volumes_mm3


def _masses_g(
    path: Path, results: Path, measured: Mapping[str, tuple[float, float]], density_kg_m3: float
) -> dict[str, float]:
    """Return the masses by bundle, in the order of the file; their numbers must fit the measured volumes."""
    try:
        columns, rows = read_rows(path, COLUMNS, tuple(COLUMNS))
        cells = {}
        for row in rows:
            bundle = row.at(columns["bundle"].number)
            if bundle in cells:
                raise TableError(f"{row.place}: {bundle} is there twice; keep one line for each bundle")
            if bundle not in measured:
                raise TableError(
                    f"{row.place}: {results} has no measured bundle {bundle!r};"
                    " remove this line, or give the results of the same stones"
                )
            about_g = measured[bundle][1] * density_kg_m3 / 1e6
            limits = Limits(
                about_g / MOST_OFF,
                about_g * MOST_OFF,
                f"is far from the {about_g:.3g} g of the measured volume: look at the unit, the stone, the density",
            )
            cell = cell_of(row, columns["mass_g"], limits)
            if cell is None:
                raise TableError(f"{row.place}: {bundle} has no mass")
            cells[bundle] = cell
        numbers, _ = numbers_of(list(cells.values()))
        masses_g = {
            bundle: numbers[cell.line.number][cell.column.number].value for bundle, cell in cells.items()
        }
    except TableError as err:
        raise VolumeModelError(str(err)) from err
    if light := [bundle for bundle, mass_g in masses_g.items() if mass_g == 0]:
        raise VolumeModelError(f"{path}: {light[0]} has the mass 0")
    return masses_g
