"""The training loop: seeded and on one thread, so that the same samples give the same weights on the same device."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from pipeline.training.architecture import BodyNetwork


@dataclass(frozen=True, slots=True, kw_only=True)
class FittingParameters:
    """Parameters of AdamW under a one-cycle schedule, and of the running mean of the weights that is kept."""

    n_steps: int
    coarse_share: float = 0.65
    """Share of the steps, the first ones, at half resolution: a quarter of the cost, and the weights hold at full."""
    learning_rate: float = 6e-3  # the highest, after the first tenth of the steps
    weight_decay: float = 1e-3
    averaged_share: float = 0.04  # of the steps: how far back the running mean of the weights reaches

    def __post_init__(self) -> None:
        if self.n_steps < 1:
            raise ValueError(f"n_steps must be at least 1, not {self.n_steps}")


@dataclass(frozen=True, slots=True)
class FittingProgress:
    """The state after a step."""

    step: int  # from 1
    loss: float  # of its batch


def new_network(seed: int) -> BodyNetwork:
    """Return a network with the random weights of a seed."""
    torch.manual_seed(seed)
    return BodyNetwork()


def fit(
    network: BodyNetwork,
    batches: Iterable[tuple[Tensor, Tensor]],
    parameters: FittingParameters,
    device: str = "cpu",
) -> Iterator[FittingProgress]:
    """Train `network` in place, step by step; it holds the averaged weights after the last one, on the CPU.

    `batches` are views (N, 2, H, W) and their coverage (N, H, W), one batch a step. The loss is the cross-entropy
    with the covered share of each pixel: where body and wall cannot be told apart, the network learns the odds, and
    unfounded confidence costs most.
    """
    torch.set_num_threads(1)
    # not every operation need have a deterministic kernel on every GPU
    torch.use_deterministic_algorithms(True, warn_only=device != "cpu")
    network.train().to(device, memory_format=torch.channels_last)
    kept = 1 - 1 / max(1.0, parameters.averaged_share * parameters.n_steps)
    averaged = AveragedModel(network, multi_avg_fn=get_ema_multi_avg_fn(kept), use_buffers=True)
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=parameters.learning_rate, weight_decay=parameters.weight_decay
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, max_lr=parameters.learning_rate, total_steps=parameters.n_steps, pct_start=0.1
    )
    for step, (views, coverage) in zip(range(1, parameters.n_steps + 1), batches, strict=True):
        views, coverage = views.to(device), coverage.to(device)[:, None]
        if step <= parameters.coarse_share * parameters.n_steps:
            views, coverage = functional.avg_pool2d(views, 2), functional.avg_pool2d(coverage, 2)
        logits = network(views.contiguous(memory_format=torch.channels_last))
        loss = functional.binary_cross_entropy_with_logits(logits, coverage)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        averaged.update_parameters(network)
        yield FittingProgress(step, loss.item())
    network.load_state_dict(averaged.module.state_dict())
    network.eval().to("cpu")
