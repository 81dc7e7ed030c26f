"""`stonefall models train`, as far as it goes without PyTorch."""

from importlib.util import find_spec
from pathlib import Path

import pytest
from research.training import TrainingPlan, train_network

from service.base.errors import UsageError


@pytest.mark.skipif(find_spec("torch") is not None, reason="PyTorch is installed")
def test_without_pytorch_it_says_what_is_missing_and_writes_nothing(tmp_path: Path) -> None:
    plan = TrainingPlan(seed=1, n_views=1, n_steps=1, batch=1)
    with pytest.raises(UsageError, match=r"training needs torch, .* pip install 'stonefall\[train\]'"):
        train_network(plan, tmp_path / "network.onnx", print, n_jobs=1)
    assert not list(tmp_path.iterdir())
