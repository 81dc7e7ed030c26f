"""How much a run tries: quick leaves out tests marked `full` or `night`, `--full` those marked `night`, `--night` none.

A property is tried with more examples the wider the extent.
"""

from collections.abc import Iterable
from typing import Any

import hypothesis
import pytest
from gate.steps import Extent

EXAMPLES = {Extent.QUICK: 6, Extent.FULL: 25, Extent.NIGHT: 100}
"""Examples of a property that says nothing else."""
FEWEST_EXAMPLES = 2


def extent_of(config: pytest.Config) -> Extent:
    """Return the widest extent that the options ask for."""
    asked = [extent for extent in (Extent.FULL, Extent.NIGHT) if config.getoption(extent)]
    return (asked or [Extent.QUICK])[-1]


def is_beyond(item: pytest.Item, extent: Extent) -> bool:
    """True for a test that is marked for a wider extent."""
    extents = list(Extent)
    return any(item.get_closest_marker(each) for each in extents[extents.index(extent) + 1 :])


def use_profile(extent: Extent) -> None:
    """Set how many examples a property is tried with in this run."""
    for each, n_examples in EXAMPLES.items():
        hypothesis.settings.register_profile(
            each,
            max_examples=n_examples,
            deadline=None,
            derandomize=True,
            suppress_health_check=[hypothesis.HealthCheck.too_slow],
        )
    hypothesis.settings.load_profile(extent)


def examples(share: float) -> hypothesis.settings:
    """Return the settings of a property that is tried with this share of the profile's examples."""
    n_examples = round(share * hypothesis.settings.default.max_examples)
    return hypothesis.settings(max_examples=max(FEWEST_EXAMPLES, n_examples))


def first_quick(values: Iterable[Any], others: Extent = Extent.FULL) -> list[Any]:
    """Return values for `parametrize` of which all but the first are tried in a wider extent only."""
    first, *rest = values
    return [
        first,
        *(pytest.param(*_arguments(each), marks=getattr(pytest.mark, others.value)) for each in rest),
    ]


def _arguments(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)
