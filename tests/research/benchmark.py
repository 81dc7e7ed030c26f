"""`stonefall benchmark`: speed of the processing on this machine, or accuracy of the whole measuring chain."""

import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

import typer
from rich.console import Console
from rich.progress import Progress

from pipeline.evaluation.scene import rig_error
from pipeline.evaluation.summaries import STONES, summaries_of
from pipeline.evaluation.trials import METHODS, STANDARDS
from pipeline.rig.design import as_built, nominal_rig
from pipeline.synthesis.bodies import Body, SurfaceKind
from pipeline.synthesis.exposure import LensPreset
from pipeline.synthesis.irregular_bodies import IRREGULAR_FORMS
from pipeline.synthesis.stones import STONE_FORMS
from research import paper
from research.accuracy import RIGS, BenchPlan, BenchResult, RigName, run_accuracy_bench
from research.performance import run_performance_bench
from research.scaling import run_scaling_bench
from research.tables import (
    accuracy_table,
    paper_tables,
    performance_tables,
    rig_lines,
    scaling_tables,
    size_table,
)
from service.base.errors import UsageError
from service.commands.options import Json, with_options
from service.commands.synthesize import (
    GlossOption,
    InterreflectionOption,
    SurfacesOption,
    body_from_file,
    looks_of,
)
from service.processing.models.networks import load_model

IRREGULAR = "irregular-bodies"
MAX_RADIUS_MM = 24.0
FILE_TABLE_WIDTH = 150
"""Width in characters of a table that is not printed to a terminal."""
SCALING_STONE_MM = 25.0
"""Size of the stone that is timed with several grids, views and workers."""

Outcome = TypeVar("Outcome")


@dataclass(frozen=True, slots=True)
class BenchmarkOptions:
    accuracy: bool = False
    """Measure distances to true surfaces instead of times."""
    paper: bool = False
    """Repeat the paper's Tables 1 to 3 and, with --pictures, its Figures 7, 8, 9 and 11: its method as a whole
    beside ours, on the same images.
    """
    model: str = "u2netp"
    """With --paper: U2-Net, by the name of a fetched model or the path of an ONNX file."""
    scaling: bool = False
    """Time one stone with several numbers of voxels, views and workers."""
    bodies: Annotated[
        str | None,
        typer.Option(
            help=f"What to measure, separated by commas: {', '.join(STANDARDS)}, {STONES} ({', '.join(STONE_FORMS)}), "
            f"{IRREGULAR} ({', '.join(IRREGULAR_FORMS)}), single classes of these, or closed mesh files in mm."
            f" Default: all; with --paper none of {IRREGULAR}."
        ),
    ] = None
    poses: Annotated[int, typer.Option(min=1, max=1000)] = 10
    """Random poses of each body; without --accuracy stones of each size, with --scaling repetitions."""
    seed: Annotated[int, typer.Option(min=0)] = 1
    """Equal seeds give equal rigs, images, bodies and poses."""
    rigs: str = ",".join(RIGS)
    """true: the one that took the images; paper: its calibration, 8 drops; ours: 20 drops."""
    lens: LensPreset = LensPreset.F2
    """Lens of the images of --accuracy; f2 as published."""
    surfaces: SurfacesOption = SurfaceKind.MOTTLED.value
    gloss: GlossOption = 0.0
    interreflection: InterreflectionOption = False
    pictures: Path | None = None
    """Folder for pictures of each body's first pose, coloured by distance."""
    as_json: Json = False
    """Print all results as JSON, with each trial."""


@with_options
def command(options: BenchmarkOptions) -> None:
    """Time the processing on this machine; with --accuracy repeat the paper's Tables 2 and 3 on rendered images."""
    if not (options.accuracy or options.paper):
        _time_stones(options.poses, options.seed, scaling=options.scaling, as_json=options.as_json)
        return
    all_bodies = (*STANDARDS, STONES) if options.paper else (*STANDARDS, STONES, IRREGULAR)
    names, own_bodies = _bodies(options.bodies or ",".join(all_bodies))
    if options.pictures is not None:
        options.pictures.mkdir(parents=True, exist_ok=True)
    plan = BenchPlan(
        poses=dict.fromkeys(names, options.poses),
        own_bodies=own_bodies,
        looks=dict.fromkeys(names, looks_of(options.surfaces, options.gloss, options.interreflection)),
        seed=options.seed,
        lens=options.lens,
        methods=paper.METHODS if options.paper else dict.fromkeys(_rigs(options.rigs), METHODS),
        model=options.model if options.paper else None,
        pictures=options.pictures,
    )
    if options.paper:
        load_model(options.model)  # better known now than in every process
    result = _with_progress("measuring", lambda on_progress: run_accuracy_bench(plan, on_progress))
    if options.paper and options.pictures is not None:
        paper.write_pictures(plan, result, options.pictures)
    if options.as_json:
        found = paper.document(plan, result) if options.paper else _document(plan, result)
        typer.echo(json.dumps(without_nan(found), indent=2, allow_nan=False))
        return
    console = Console(width=None if sys.stdout.isatty() else FILE_TABLE_WIDTH)
    for line in rig_lines(plan, result):
        console.print(line, highlight=False)
    of_accuracy = (accuracy_table, size_table)
    tables = paper_tables(plan, result) if options.paper else [table(plan, result) for table in of_accuracy]
    console.print(*tables)


def _time_stones(poses: int, seed: int, *, scaling: bool, as_json: bool) -> None:
    if scaling:
        found = run_scaling_bench(SCALING_STONE_MM, poses, seed)
        document: Any = asdict(found) | {"exponents": found.exponents()}
        tables = scaling_tables(found, seed)
    else:
        times = _with_progress("timing", lambda on_progress: run_performance_bench(poses, seed, on_progress))
        document = [asdict(row) for row in times]
        tables = performance_tables(times, seed)
    if as_json:
        typer.echo(json.dumps(document, indent=2))
        return
    Console(width=None if sys.stdout.isatty() else FILE_TABLE_WIDTH).print(*tables)


def _document(plan: BenchPlan, result: BenchResult) -> dict[str, Any]:
    """Return everything JSON-ready; an average of no trial is null."""
    true_rig = as_built(nominal_rig(), plan.seed)
    return {
        "seed": plan.seed,
        "poses": dict(plan.poses),
        "looks": {name: asdict(looks) for name, looks in plan.looks.items()},
        "rigs": {
            name: {
                "rms_mm": error.rms_mm,
                "scale_percent": error.scale_percent,
                "held_out_px": report.held_out_px,
            }
            for name, report in result.reports.items()
            for error in [rig_error(report.rig, true_rig)]
        },
        "refused": dict(result.refused),
        "summaries": [
            summary.document()
            for summaries in summaries_of(plan.poses, result.trials).values()
            for summary in summaries
        ],
        "trials": [asdict(trial) for trial in result.trials],
    }


def without_nan(values: Any) -> Any:
    """Return JSON-ready values, with null in the place of what is no number."""
    if isinstance(values, Mapping):
        return {key: without_nan(value) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [without_nan(value) for value in values]
    return None if values != values else values


def _bodies(text: str) -> tuple[tuple[str, ...], dict[str, Body]]:
    """Return the names of the bodies, each once, and the bodies that were read from mesh files."""
    groups = {STONES: tuple(STONE_FORMS), IRREGULAR: tuple(IRREGULAR_FORMS)}
    known = [*STANDARDS, *groups, *STONE_FORMS, *IRREGULAR_FORMS]
    limit = f", more than the {MAX_RADIUS_MM:g} mm that the cameras see"
    own_bodies: dict[str, Body] = {}
    names: list[str] = []
    for name in filter(None, (part.strip() for part in text.split(","))):
        if name in groups:
            names += groups[name]
        elif name in known:
            names.append(name)
        else:
            body = body_from_file(name, known, MAX_RADIUS_MM, limit)
            if body.name in known:
                raise UsageError(f"{name}: has the name of a generated body; rename the file")
            if body.name in own_bodies:
                raise UsageError(f"{name}: another mesh file is also named {body.name}; rename one of them")
            own_bodies[body.name] = body
            names.append(body.name)
    if not names:
        raise typer.BadParameter("names no body", param_hint="--bodies")
    return tuple(dict.fromkeys(names)), own_bodies


def _rigs(text: str) -> tuple[RigName, ...]:
    names = [part.strip() for part in text.split(",")]
    wrong = [name for name in names if name not in get_args(RigName)]
    if wrong:
        raise typer.BadParameter(f"{wrong[0]!r} is none of {', '.join(RIGS)}", param_hint="--rigs")
    return tuple(rig for rig in RIGS if rig in names)


def _with_progress(label: str, run: Callable[[Callable[[int, int], None]], Outcome]) -> Outcome:
    with Progress(console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task(label, total=None)
        return run(lambda done, total: progress.update(bar, completed=done, total=total))
