"""`stonefall fit-volume`: fit the volume correction to stones that were measured and weighed."""

import csv
import io
import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pipeline.measuring.volume_correction import fit_volume_model
from service.base.errors import UsageError, VolumeModelError
from service.commands.options import DensityOptions, with_options
from service.configuration.volume_models import write_volume_model
from service.results.fields import Outcome

FIELDS = ("volume_raw_mm3", "volume_estimate_mm3")
MAX_VOLUME_MM3 = 1e6
"""Volume of a cube of 100 mm, which is larger than the field of view."""


@with_options
def command(
    results: Annotated[Path, typer.Argument(help="results.jsonl of `stonefall measure`.")],
    weighed: Annotated[Path, typer.Argument(help="CSV file with the columns bundle and mass_g.")],
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
    masses_g = _masses_g(weighed)
    unknown = sorted(set(masses_g) - set(measured))
    if unknown:
        raise VolumeModelError(
            f"{weighed}: {results} has no measured bundle {', '.join(unknown[:3])};"
            " remove these lines, or give the results of the same stones"
        )
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
    for number, line in enumerate(_text(path).splitlines(), start=1):
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


def _masses_g(path: Path) -> dict[str, float]:
    """Return the masses by bundle, in the order of the file."""
    masses_g: dict[str, float] = {}
    rows = csv.DictReader(io.StringIO(_text(path), newline=""))
    if not {"bundle", "mass_g"} <= set(rows.fieldnames or ()):
        raise VolumeModelError(f"{path}: the first line must name the columns bundle and mass_g")
    for row in rows:
        bundle = row["bundle"] or ""
        try:
            mass_g = float(row["mass_g"])
        except (TypeError, ValueError):
            mass_g = float("nan")
        if not 0 < mass_g < 1e6:
            raise VolumeModelError(
                f"{path}: line {rows.line_num}: mass_g must be a positive number, not {row['mass_g']!r}"
            )
        if bundle in masses_g:
            raise VolumeModelError(
                f"{path}: line {rows.line_num}: {bundle} is there twice; keep one line for each bundle"
            )
        masses_g[bundle] = mass_g
    return masses_g


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as err:
        raise VolumeModelError(f"{path}: is not written in UTF-8; save it as UTF-8") from err
