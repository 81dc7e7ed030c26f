"""`stonefall shape`: measure mesh files with the functions of the pipeline."""

import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import trimesh
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Column, Table

from drivers.errors import RecordingError
from drivers.files.mesh_parsing import MESH_DAMAGE, parse_mesh
from pipeline.errors import MeshError
from pipeline.measuring import ShapeMeasurement, measure_shape
from service.base.errors import UsageError
from service.results.fields import MEASURED_FIELDS

SUFFIXES = (".stl", ".ply", ".obj")
MESHES_PER_TABLE = 3

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
    """Measure mesh files with the functions that measure stones."""
    errors = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)
    measured: list[dict[str, Any]] = []
    for path in track(meshes, "Measuring", console=errors, transient=True, disable=not errors.is_terminal):
        try:
            mesh = read_mesh(path)
            measured.append({"file": str(path)} | asdict(measure_shape(mesh.vertices, mesh.faces)))
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


def read_mesh(path: Path) -> trimesh.Trimesh:
    """Read a mesh, and merge its equal vertices; raise `UsageError` for what is no readable mesh."""
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"must be one of {', '.join(SUFFIXES)}")
    try:
        mesh = parse_mesh(path)
        if np.isfinite(mesh.vertices).all():
            # STL repeats vertices for each face, OBJ where texture or normals break
            mesh.merge_vertices(merge_tex=True, merge_norm=True)
    except RecordingError as err:
        raise UsageError(err.problem) from err
    except MESH_DAMAGE as err:
        raise UsageError("is damaged: its vertices cannot be compared") from err
    return mesh


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, tuple):
        return " × ".join(f"{edge:.3f}" for edge in value)
    return f"{value:.4g}" if value < 1 else f"{value:.3f}"
