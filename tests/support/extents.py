"""How much a run tries: `quick` leaves out tests marked `full` and most examples of a property, `--full` nothing."""

from collections.abc import Iterable
from typing import Any

import hypothesis
import pytest

PROFILES = {"quick": 10, "full": 100}
"""Examples of a property that says nothing else."""
FEWEST_EXAMPLES = 2


def use_profile(is_full: bool) -> None:
    """Set how many examples a property is tried with in this run."""
    for name, n_examples in PROFILES.items():
        hypothesis.settings.register_profile(
            name,
            max_examples=n_examples,
            deadline=None,
            derandomize=True,
            suppress_health_check=[hypothesis.HealthCheck.too_slow],
        )
    hypothesis.settings.load_profile("full" if is_full else "quick")


def examples(share: float) -> hypothesis.settings:
    """Return the settings of a property that is tried with this share of the profile's examples."""
    n_examples = round(share * hypothesis.settings.default.max_examples)
    return hypothesis.settings(max_examples=max(FEWEST_EXAMPLES, n_examples))


def first_quick(values: Iterable[Any]) -> list[Any]:
    """Return values for `parametrize` of which all but the first are tried with `--full` only."""
    first, *others = values
    return [first, *(pytest.param(*_arguments(other), marks=pytest.mark.full) for other in others)]


def _arguments(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)
