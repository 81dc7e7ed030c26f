"""Train our own segmentation network and write it beside its description.

The same seed, views and steps give the same network on the same kind of processor; nothing is measured with what
is computed here until the file is put where segmentation looks for it.
"""

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.evaluation.hard_cases import HardCase
from pipeline.segmentation.network import load_network
from pipeline.training.image_layers import render_bodies, render_walls
from pipeline.training.samples import Sample, compose
from pipeline.training.scores import score, validation_view
from service.errors import UsageError

WALLS_PER_BODY = 0.4
EXAM_SEEDS = range(700_000, 700_006)
"""Views of each hard case that a new network is examined on; training draws from other streams."""
EXAM_WITHOUT_BACKGROUND = range(700_100, 700_103)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingPlan:
    """All that a network depends on."""

    seed: int
    n_views: int
    n_steps: int


def train_network(plan: TrainingPlan, out: Path, say: Callable[[str], None]) -> dict[str, Any]:
    """Write the ONNX file `out` and its description `out.json`, which is returned; tell `say` how it goes.

    Raises
    ------
    UsageError
        PyTorch is not installed.
    """
    try:
        from pipeline.training import architecture, exporting, fitting
    except ModuleNotFoundError as err:
        raise UsageError(
            f"training needs {err.name}, which is not installed: pip install 'stonefall[train]'"
        ) from err

    say(f"rendering {plan.n_views} views of stones")
    bodies = list(islice(render_bodies(plan.seed), plan.n_views))
    walls = list(islice(render_walls(plan.seed), max(1, round(WALLS_PER_BODY * plan.n_views))))

    def samples() -> Iterator[Sample]:
        rng = np.random.default_rng([plan.seed, 2])
        while True:
            yield compose(bodies, walls, rng)

    network = fitting.new_network(plan.seed)
    losses: list[float] = []
    for progress in fitting.fit(network, samples(), fitting.FittingParameters(n_steps=plan.n_steps)):
        losses.append(progress.loss)
        if progress.step % 100 == 0 or progress.step == plan.n_steps:
            say(f"step {progress.step} of {plan.n_steps}: loss {np.mean(losses[-100:]):.4f}")

    say("examining it on hard cases it never saw")
    n_parameters = architecture.n_parameters(network)
    metrics = examine(exporting.to_onnx(network, {}))
    how = {
        "seed": plan.seed,
        "trained_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "n_views": plan.n_views,
        "n_steps": plan.n_steps,
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
        "command": f"stonefall models train --seed {plan.seed} --views {plan.n_views} --steps {plan.n_steps}",
        "metrics": metrics,
    }
    out.write_bytes(model)
    out.with_suffix(".json").write_text(json.dumps(description, indent=2) + "\n", encoding="utf-8")
    return description


def examine(model: bytes) -> dict[str, dict[str, float]]:
    """Scores of a network, by hard case; `no-background` is all cases without one."""
    probability = load_network(model).probability
    known = score((validation_view(case, seed) for case in HardCase for seed in EXAM_SEEDS), probability)
    unknown = score(
        (
            validation_view(case, seed, with_background=False)
            for case in (HardCase.CLEAN, HardCase.DUST, HardCase.DIMMED, HardCase.FLICKER)
            for seed in EXAM_WITHOUT_BACKGROUND
        ),
        probability,
    )
    scores = {
        **{str(case): asdict(value) for case, value in known.items()},
        **{f"{case} without background": asdict(value) for case, value in unknown.items()},
    }
    return {name: {key: round(value, 4) for key, value in values.items()} for name, values in scores.items()}
