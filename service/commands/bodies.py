"""What `synthesize` and `benchmark` render: bodies from mesh files, and the options about their look."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from pipeline.errors import MeshError
from pipeline.synthesis.bodies import Body, Looks, SurfaceKind, body_from_mesh
from service.base.errors import UsageError
from service.commands.shape import read_mesh

SurfacesOption = Annotated[
    str,
    typer.Option(
        "--surface",
        help=f"Surfaces of the bodies in turn, separated by commas: {', '.join(SurfaceKind)}. Balls keep theirs.",
    ),
]
GlossOption = Annotated[
    float, typer.Option("--gloss", min=0, max=1, help="How wet bodies are: 0 matte, 1 wet.")
]
InterreflectionOption = Annotated[
    bool, typer.Option("--interreflection", help="Faces of a body light and mirror each other.")
]


def looks_of(surfaces: str, gloss: float, interreflection: bool) -> Looks:
    """Parse the options about the look of bodies; raise `typer.BadParameter` for an unknown surface."""
    names = [name.strip() for name in surfaces.split(",")]
    if unknown := [name for name in names if name not in set(SurfaceKind)]:
        raise typer.BadParameter(
            f"{unknown[0]!r} is none of {', '.join(SurfaceKind)}", param_hint="--surface"
        )
    return Looks(surfaces=tuple(map(SurfaceKind, names)), gloss=gloss, is_interreflecting=interreflection)


def body_from_file(name: str, known: Iterable[str], max_radius_mm: float, limit: str = "") -> Body:
    """Read a body from a mesh file; `known` are the other bodies, and `limit` says why none is larger.

    Raises `typer.BadParameter` if there is no such file, `UsageError` if it is no closed mesh, or too large.
    """
    path = Path(name)
    if not path.is_file():
        raise typer.BadParameter(
            f"{name!r} is neither a mesh file nor one of {', '.join(known)}", param_hint="--bodies"
        )
    try:
        body = body_from_mesh(path.stem, read_mesh(path))
    except (UsageError, MeshError) as err:
        raise UsageError(f"{path}: {err}") from err
    if body.radius_mm > max_radius_mm:
        raise UsageError(f"{path}: reaches {body.radius_mm:.0f} mm from its centre{limit}; is it in mm?")
    return body
