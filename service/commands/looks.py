"""The options of `synthesize` and `benchmark` that say how synthetic bodies look."""

from typing import Annotated

import typer

from pipeline.synthesis.bodies import Looks, SurfaceKind

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
    """Parse the options about the look of bodies.

    Raises
    ------
    typer.BadParameter
        There is no such surface.
    """
    names = [name.strip() for name in surfaces.split(",")]
    if unknown := [name for name in names if name not in set(SurfaceKind)]:
        raise typer.BadParameter(
            f"{unknown[0]!r} is none of {', '.join(SurfaceKind)}", param_hint="--surface"
        )
    return Looks(surfaces=tuple(map(SurfaceKind, names)), gloss=gloss, is_interreflecting=interreflection)
