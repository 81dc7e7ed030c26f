"""Train our own segmentation network and write it with its description.

The same plan gives the same network on the same kind of processor, whatever the number of processes. Nothing is
measured with a new network until its file replaces the built-in one or the configuration names it.
"""

import hashlib
import json
import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import partial
from itertools import chain, product
from math import ceil
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from drivers.files.durable import write_file
from pipeline.evaluation.hard_cases import HardCase
from pipeline.segmentation.network import load_network
from pipeline.training.image_layers import (
    CROPS_PER_WALL,
    VIEWS_PER_BODY,
    BodyLayer,
    WallLayer,
    render_body,
    render_wall,
)
from pipeline.training.samples import Samples
from pipeline.training.scores import ValidationView, score, validation_view
from service.base.errors import UsageError
from service.processing.models.networks import Device

WALLS_PER_BODY = 0.4
"""Rendered views of the empty rig for each view of a stone."""
EXAM_SEEDS = range(700_000, 700_006)
"""Views of each hard case that a new network is examined on; training draws from other streams."""
EXAM_WITHOUT_BACKGROUND = range(700_100, 700_103)
CASES_WITHOUT_BACKGROUND = (
    HardCase.CLEAN, HardCase.DUST, HardCase.DIMMED, HardCase.FLICKER, HardCase.F2, HardCase.DEFOCUS,
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingPlan:
    """Everything that a trained network depends on, but for the kind of processor."""

    seed: int
    n_views: int
    n_steps: int
    batch: int  # samples a step


def train_network(
    plan: TrainingPlan, out: Path, say: Callable[[str], None], *, n_jobs: int, device: Device = Device.AUTO
) -> dict[str, Any]:
    """Write the ONNX file `out` and its description `out.json`, which is returned; report progress to `say`.

    `n_jobs` processes render and compose. Raises `UsageError` when PyTorch is not installed, or sees no GPU though
    `device` is one.
    """
    try:
        import torch

        from pipeline.training import architecture, exporting, fitting
    except ModuleNotFoundError as err:
        raise UsageError(
            f"training needs {err.name}, which is not installed: pip install 'stonefall[train]'"
        ) from err

    has_gpu = torch.cuda.is_available()
    if device is Device.CUDA and not has_gpu:
        raise UsageError("PyTorch sees no GPU: --device cpu trains without one")
    used = Device.CUDA if has_gpu and device is not Device.CPU else Device.CPU

    say(f"rendering {plan.n_views} views of bodies in {n_jobs} processes")
    bodies, walls, exam, exam_without = render_all(plan, n_jobs)

    samples = Samples(bodies=bodies, walls=walls, seed=plan.seed, count=plan.n_steps * plan.batch)
    batches = torch.utils.data.DataLoader(
        samples,
        batch_size=plan.batch,
        num_workers=n_jobs,
        multiprocessing_context="fork",  # which shares the layers
        worker_init_fn=_use_one_thread,
    )
    network = fitting.new_network(plan.seed)
    losses: list[float] = []
    for progress in fitting.fit(network, batches, fitting.FittingParameters(n_steps=plan.n_steps), used):
        losses.append(progress.loss)
        if progress.step % 100 == 0 or progress.step == plan.n_steps:
            say(f"step {progress.step} of {plan.n_steps}: loss {np.mean(losses[-100:]):.4f}")

    say("examining it on hard cases it never saw")
    n_parameters = architecture.n_parameters(network)
    metrics = examine(exporting.to_onnx(network, {}), exam, exam_without)
    how = {
        **asdict(plan),
        "trained_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "device": torch.cuda.get_device_name() if used is Device.CUDA else str(used),
        "jobs": n_jobs,
        "final_loss": round(float(np.mean(losses[-100:])), 5),
    }
    model = exporting.to_onnx(
        network,
        {
            **{name: str(value) for name, value in how.items()},
            "metrics": json.dumps(metrics),
            "parameters": str(n_parameters),
        },
    )
    description = {
        "sha256": hashlib.sha256(model).hexdigest(),
        "n_parameters": n_parameters,
        **how,
        "command": f"stonefall models train --seed {plan.seed} --views {plan.n_views} --steps {plan.n_steps}"
        f" --batch {plan.batch} --device {used} --jobs {n_jobs}",
        "metrics": metrics,
    }
    write_file(out, model)
    write_file(out.with_suffix(".json"), (json.dumps(description, indent=2) + "\n").encode())
    return description


def render_all(
    plan: TrainingPlan, n_jobs: int
) -> tuple[list[BodyLayer], list[WallLayer], list[ValidationView], list[ValidationView]]:
    """Return the layers to train with, and the views with and without a background that the network is examined on."""
    with ProcessPoolExecutor(
        n_jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_use_one_thread
    ) as pool:
        n_bodies = ceil(plan.n_views / VIEWS_PER_BODY)
        n_walls = ceil(WALLS_PER_BODY * plan.n_views / CROPS_PER_WALL)
        bodies = pool.map(partial(render_body, plan.seed), range(n_bodies))
        walls = pool.map(partial(render_wall, plan.seed), range(n_walls))
        known = pool.map(validation_view, *zip(*product(HardCase, EXAM_SEEDS), strict=True))
        unknown = pool.map(
            partial(validation_view, with_background=False),
            *zip(*product(CASES_WITHOUT_BACKGROUND, EXAM_WITHOUT_BACKGROUND), strict=True),
        )
        return list(chain(*bodies)), list(chain(*walls)), list(known), list(unknown)


def examine(
    model: bytes, exam: list[ValidationView], exam_without: list[ValidationView]
) -> dict[str, dict[str, float]]:
    """Return the scores of a network by hard case, with and without a background."""
    probability = load_network(model).probability
    known, unknown = score(exam, probability), score(exam_without, probability)
    scores = {
        **{str(case): asdict(value) for case, value in known.items()},
        **{f"{case} without background": asdict(value) for case, value in unknown.items()},
    }
    return {name: {key: round(value, 4) for key, value in values.items()} for name, values in scores.items()}


def _use_one_thread(_worker: int = 0) -> None:
    cv2.setNumThreads(1)
