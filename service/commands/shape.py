"""`stonefall shape`: measure mesh files with the functions of the pipeline."""

import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Column, Table

from drivers.errors import RecordingError
from drivers.files.mesh_parsing import MESH_DAMAGE, parse_mesh
from pipeline.arrays import Faces, PointsMM
from pipeline.errors import MeshError
from pipeline.measuring import ShapeMeasurement, measure_shape
from pipeline.meshing.connected_surfaces import bodies_of
from service.base.errors import UsageError
from service.results.fields import MEASURED_FIELDS

SUFFIXES = (".stl", ".ply", ".obj")
MESHES_PER_TABLE = 3
STONES_MM = (1.0, 200.0)
"""Lengths of stones: what is shorter or longer is likely not in mm."""
UNITS_MM = {"metres": 1000.0, "inches": 25.4, "centimetres": 10.0, "micrometres": 0.001}

ROWS = [name for name in MEASURED_FIELDS if name in {field.name for field in fields(ShapeMeasurement)}]
"""Fields of a result that follow from a mesh alone, in the order of the result."""


def command(
    meshes: Annotated[
        list[Path], typer.Argument(metavar="MESH...", help="Closed meshes in mm: STL, PLY, OBJ.")
    ],
    as_json: Annotated[
        bool, typer.Option("--json", help="Print a JSON list with one object for each mesh.")
    ] = False,
) -> None:
    """Measure mesh files with the functions that measure stones; of several bodies in a file, the largest."""
    errors = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)
    measured: list[dict[str, Any]] = []
    for path in track(meshes, "Measuring", console=errors, transient=True, disable=not errors.is_terminal):
        try:
            vertices_mm, (largest, *others) = read_bodies(path)
            shape = measure_shape(vertices_mm, largest)
            measured.append({"file": str(path)} | asdict(shape))
            left_out = f"of {len(others) + 1} bodies only the largest is measured" if others else None
            for doubt in filter(None, (left_out, scale_doubt(shape.length_mm))):
                errors.print(f"stonefall: {path}: warning: {doubt}")
        except (MeshError, UsageError) as err:
            errors.print(f"stonefall: {path}: {err}")
    if as_json:
        typer.echo(json.dumps(measured, indent=2, allow_nan=False))
    else:
        console = Console()
        for i in range(0, len(measured), MESHES_PER_TABLE):
            shown = measured[i : i + MESHES_PER_TABLE]
            files = (Column(Path(shape["file"]).name, justify="right", overflow="fold") for shape in shown)
            table = Table(Column(no_wrap=True), *files)
            for name in ROWS:
                table.add_row(name, *(_text(shape[name]) for shape in shown))
            console.print(table)
    if len(measured) < len(meshes):
        raise typer.Exit(1)


def read_bodies(path: Path) -> tuple[PointsMM, list[Faces]]:
    """Return the vertices (N, 3) of a mesh file, equal ones merged, and the faces of each body, the largest first.

    Raises `UsageError` for what is no readable mesh.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"must be one of {', '.join(SUFFIXES)}")
    try:
        mesh = parse_mesh(path)
        if mesh.faces.size == 0 or not np.isfinite(mesh.vertices).all():
            return mesh.vertices, [mesh.faces]
        # STL repeats vertices for each face, OBJ where texture or normals break
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
    except RecordingError as err:
        raise UsageError(err.problem) from err
    except MESH_DAMAGE as err:
        raise UsageError("is damaged: its vertices cannot be compared") from err
    return mesh.vertices, bodies_of(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64))


def scale_doubt(length_mm: float) -> str | None:
    """Return the doubt that a length is in mm, with the factors that would make a stone of it; None without doubt."""
    low_mm, high_mm = STONES_MM
    if low_mm <= length_mm <= high_mm:
        return None
    scaled_mm = {unit: factor * length_mm for unit, factor in UNITS_MM.items()}
    fitting = (
        f"; if in {unit}, scale it by {UNITS_MM[unit]:g} to {scaled:.3g} mm"
        for unit, scaled in scaled_mm.items()
        if low_mm <= scaled <= high_mm
    )
    length = f"{length_mm:.3g}" if length_mm < low_mm else f"{length_mm:.0f}"
    return f"is {length} mm long, is it in mm?{''.join(fitting)}"


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, tuple):
        return " × ".join(f"{edge:.3f}" for edge in value)
    return f"{value:.4g}" if value < 1 else f"{value:.3f}"
