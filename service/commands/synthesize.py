"""`stonefall synthesize`: render a recording of known bodies, with their true shapes beside it."""

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import trimesh
import typer
from rich.console import Console
from rich.progress import track

from drivers.files.recording import RecordingSource, RecordingWriter
from drivers.files.rig_file import read_rig, write_rig
from pipeline.errors import MeshError
from pipeline.fall import GRAVITY_MM_S2, Fall
from pipeline.frames import BundleKind, rfc3339
from pipeline.measuring import ShapeMeasurement, measure_shape
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.synthesis.bodies import Body, Looks, SurfaceKind, ball, body_from_mesh, cube, cylinder, sphere
from pipeline.synthesis.bundles import FIRST_UTC, Timing, render_bundle, render_empty, stream
from pipeline.synthesis.exposure import BLUR_PX, LENS_PRESETS, LensPreset
from pipeline.synthesis.placement import SPREAD_MM, drop_across, tumble
from pipeline.synthesis.renderer import simulate_rig
from pipeline.synthesis.stones import STONE_FORMS, random_size_mm, stone
from pipeline.synthesis.truth import truth_of, truth_to_document
from service.base.errors import UsageError
from service.commands.options import Json, changed, with_options
from service.commands.shape import read_bodies, scale_doubt

STANDARDS: dict[str, Callable[[], Body]] = {each.__name__: each for each in (ball, sphere, cylinder, cube)}
STONES = "stones"
MAX_RADIUS_MM = 100.0
BALL_DIAMETERS_MM = (2.0, 40.0)
MAX_FALL_JITTER_MS = 6.0
"""Beyond it the ball is outside the field of view."""

HOUSING, BACKGROUND, PARTICLE = range(3)
"""Keys of the random streams: the content of a bundle does not depend on the number of bundles."""

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

BodySource = Callable[[int, np.random.Generator], tuple[Body, ShapeMeasurement]]
"""Returns the body, and its true shape, that an item of `--bodies` stands for in the n-th round (from 0)."""


@dataclass(frozen=True, slots=True)
class SynthesizeOptions:
    out: Annotated[Path, typer.Argument()]
    """Folder of the recording; must not exist, or be empty."""
    bodies: Annotated[
        str,
        typer.Option(
            help=f"Bodies that fall in turn, separated by commas: {', '.join(STANDARDS)} (of another diameter in mm: "
            f"ball:15), {STONES} "
            f"(in turn {', '.join(STONE_FORMS)}), one of these classes, or mesh files in mm."
        ),
    ] = f"{','.join(STANDARDS)},{STONES}"
    count: Annotated[int, typer.Option(min=0, max=100_000)] = 10
    """Number of bodies."""
    seed: Annotated[int, typer.Option(min=0)] = 0
    """Equal seeds give equal images."""
    rig: Path | None = None
    """Rig file of the cameras; default: the design with seeded deviations."""
    shrink: Annotated[int, typer.Option(min=1, max=8)] = 1
    """Images of 1/N of the pixels in each direction, for a machine that is too slow for whole ones."""
    backgrounds: Annotated[int, typer.Option(min=0, max=1000)] = 5
    """Number of exposures of the empty rig, before the bodies."""
    size_mm: Annotated[float | None, typer.Option(min=1, max=45)] = None
    """Greatest diameter of the stones, mm; default: 5 to 40, at random."""
    exposure_us: Annotated[float, typer.Option(min=0, max=1000)] = 20.0
    """Exposure time, us; motion blur is 1 px in 20 us."""
    lens: LensPreset = LensPreset.SHARP
    """Lens of 25 mm, focused at 300 mm, at an f-number (f2 as published), with depth blur, vignetting and glare;
    sharp: the same small blur for everything."""
    blur_px: Annotated[float | None, typer.Option(min=BLUR_PX[0], max=BLUR_PX[1])] = None
    """Blur (sigma) of a point in focus, px; default: the lens's."""
    read_noise: Annotated[float | None, typer.Option(min=0, max=50)] = None
    """Noise (sigma) of the sensor in the dark, grey levels; default: 0.8."""
    rate_hz: Annotated[float, typer.Option(min=0.01, max=100)] = 4.0
    """Triggers per second."""
    spread_mm: Annotated[tuple[float, float, float], typer.Option(metavar="X Y Z")] = SPREAD_MM
    """Balls fall up to this far from the centre, mm."""
    fall_jitter_ms: Annotated[float, typer.Option(min=0, max=MAX_FALL_JITTER_MS)] = 0.0
    """Balls are exposed up to this much early or late, ms, and so higher or lower."""
    surfaces: SurfacesOption = SurfaceKind.MOTTLED.value
    gloss: GlossOption = 0.0
    interreflection: InterreflectionOption = False
    as_json: Json = False
    """Print the summary as JSON."""


@with_options
def command(options: SynthesizeOptions) -> None:
    """Render a recording of known bodies as the cameras would see them, with their true shapes beside it."""
    if options.backgrounds + options.count == 0:
        raise typer.BadParameter("there is nothing to render", param_hint="--count")
    if not all(0 <= each <= MAX_RADIUS_MM for each in options.spread_mm):
        raise typer.BadParameter(
            f"{options.spread_mm}: each must be 0 to {MAX_RADIUS_MM:g}", param_hint="--spread-mm"
        )
    looks = looks_of(options.surfaces, options.gloss, options.interreflection)
    exposure = replace(LENS_PRESETS[options.lens], exposure_us=options.exposure_us)
    exposure = changed(exposure, blur_px=options.blur_px, read_noise=options.read_noise)
    design = nominal_rig(created_at=rfc3339(FIRST_UTC, "auto"))
    true_rig = as_built(design, options.seed) if options.rig is None else read_rig(options.rig)
    design, true_rig = _shrunk(design, options.shrink), _shrunk(true_rig, options.shrink)
    names = [name.strip() for name in options.bodies.split(",")]
    timing = Timing(period_ns=round(1e9 / options.rate_hz))
    simulated = simulate_rig(true_rig, stream(options.seed, HOUSING), exposure)
    writer = RecordingWriter(
        options.out,
        RecordingSource(
            camera_ids=true_rig.camera_ids,
            rig=true_rig,
            is_simulated=True,
            camera_settings={"exposure_us": options.exposure_us},
            gate_settings={"trigger_delay_ms": timing.delay_ns / 1e6, "rate_hz": options.rate_hz},
        ),
        made_by={
            "command": "synthesize",
            "bodies": names,
            "count": options.count,
            "seed": options.seed,
            "size_mm": options.size_mm,
            "looks": asdict(looks),
            "spread_mm": list(options.spread_mm),
            "fall_jitter_ms": options.fall_jitter_ms,
            "exposure": {"preset": options.lens.value, **asdict(exposure)},
            "rig": "rig.json took the images"
            + ("; rig-nominal.json is its design" if options.rig is None else ""),
            "truth": "truth.jsonl; truth/*.ply in world coordinates in the middle of the exposure",
        },
    )
    with writer:
        sources = [_body_source(name, options.size_mm) for name in names]
        if options.rig is None:
            write_rig(writer.folder / "rig-nominal.json", design)
        (writer.folder / "truth").mkdir()
        with (writer.folder / "truth.jsonl").open("w", encoding="utf-8") as truth_lines:
            numbers = range(1, options.backgrounds + options.count + 1)
            for sequence in track(numbers, "synthesizing", console=Console(stderr=True)):
                index = sequence - 1 - options.backgrounds
                if index < 0:
                    rng = stream(options.seed, BACKGROUND, sequence)
                    writer.add(render_empty(simulated, rng, sequence=sequence, timing=timing))
                    continue
                source, round_number = sources[index % len(sources)], index // len(sources)
                rng = stream(options.seed, PARTICLE, index)
                body, shape = source(round_number, rng)
                body = looks.of(body, round_number)
                if body.kind is BundleKind.BALL:
                    late_ms = options.fall_jitter_ms * float(rng.uniform(-1, 1))
                    placed = drop_across(body, true_rig, rng, options.spread_mm, _fallen_mm(late_ms))
                else:
                    late_ms, placed = 0.0, tumble(body, true_rig, rng)
                bundle = render_bundle(
                    [placed],
                    simulated,
                    rng,
                    sequence=sequence,
                    label=body.name,
                    timing=replace(timing, delay_ns=timing.delay_ns + round(late_ms * 1e6)),
                )
                truth = truth_of(placed, bundle, shape)
                writer.add(bundle)
                truth.mesh.export(writer.folder / "truth" / f"{bundle.name}.ply")
                truth_lines.write(json.dumps(truth_to_document(truth), allow_nan=False) + "\n")
    summary = {
        "recording": str(options.out),
        "backgrounds": options.backgrounds,
        "bodies": options.count,
        "rig": true_rig.calibration_id,
    }
    typer.echo(
        json.dumps(summary)
        if options.as_json
        else f"{options.out}: {options.count} bodies, {options.backgrounds} exposures of the empty rig"
    )


def _shrunk(rig: RigCalibration, n: int) -> RigCalibration:
    """Return the rig with pixels `n` times as large in each direction."""
    if n == 1:
        return rig
    offset = (1 / n - 1) / 2  # centres of pixels are on integers, so the image begins at -0.5
    scale = np.array([[1 / n, 0, offset], [0, 1 / n, offset], [0, 0, 1]])
    cameras = (
        replace(
            camera,
            image_size_px=(camera.image_size_px[0] // n, camera.image_size_px[1] // n),
            K=scale @ camera.K,
        )
        for camera in rig.cameras
    )
    return replace(rig, cameras=tuple(cameras))


def _fallen_mm(late_ms: float) -> float:
    """Return the path of a falling body, mm, from the expected exposure to `late_ms` after it."""
    late_s = late_ms / 1e3
    return Fall().speed_at_center_mm_s * late_s + GRAVITY_MM_S2 / 2 * late_s**2


def _body_source(name: str, size_mm: float | None) -> BodySource:
    """Parse an item of `--bodies`: stones of one form or all, or a single body."""
    if name in STONE_FORMS or name == STONES:
        forms = list(STONE_FORMS) if name == STONES else [name]

        def next_stone(round_number: int, rng: np.random.Generator) -> tuple[Body, ShapeMeasurement]:
            body = stone(forms[round_number % len(forms)], size_mm or random_size_mm(rng), rng)
            return body, measure_shape(body.mesh.vertices, body.mesh.faces)

        return next_stone
    kind, _, diameter = name.partition(":")
    if name in STANDARDS:
        body = STANDARDS[name]()
    elif kind == "ball":
        low_mm, high_mm = BALL_DIAMETERS_MM
        try:
            diameter_mm = float(diameter)
        except ValueError:
            diameter_mm = 0.0
        if not low_mm <= diameter_mm <= high_mm:
            raise typer.BadParameter(
                f"{name!r}: a ball's diameter is {low_mm:g} to {high_mm:g} mm, as in ball:15",
                param_hint="--bodies",
            )
        body = ball(diameter_mm)
    else:
        body = body_from_file(name, [*STANDARDS, STONES, *STONE_FORMS], MAX_RADIUS_MM)
    shape = measure_shape(body.mesh.vertices, body.mesh.faces)
    return lambda round_number, rng: (body, shape)


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

    Raises `typer.BadParameter` if there is no such file, `UsageError` if it is not one closed mesh, or too large.
    """
    path = Path(name)
    if not path.is_file():
        raise typer.BadParameter(
            f"{name!r} is neither a mesh file nor one of {', '.join(known)}", param_hint="--bodies"
        )
    try:
        vertices_mm, bodies = read_bodies(path)
        if len(bodies) > 1:
            raise UsageError(f"has {len(bodies)} bodies: the truth is one; leave the largest alone in it")
        body = body_from_mesh(path.stem, trimesh.Trimesh(vertices_mm, bodies[0], process=False))
    except (UsageError, MeshError) as err:
        raise UsageError(f"{path}: {err}") from err
    doubt = scale_doubt(measure_shape(body.mesh.vertices, body.mesh.faces).length_mm)
    if body.radius_mm > max_radius_mm:
        reach = f"reaches {body.radius_mm:.0f} mm from its centre{limit}"
        raise UsageError(f"{path}: {reach}; {doubt or 'is it in mm?'}")
    if doubt is not None:
        typer.echo(f"stonefall: {path}: warning: {doubt}", err=True)
    return body
