"""A plugin of pytest: how the gate's files of tests are shared among processes.

Whole rigs and browsers run one after the other in one process, as they mostly wait and want a processor at once when
they do not: what else runs has a lower priority. A file stays in one process, so its fixtures are made once.
"""

import os

import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling

from gate.steps import RIGS

NICE = 5
"""Added to the niceness of a process that has no rigs before it (nice(2))."""


class RigsTogether(LoadFileScheduling):  # type: ignore[misc]  # xdist has no types
    """Files go to the next free process in the order of the command; all rigs count as one file."""

    def _split_scope(self, nodeid: str) -> str:
        return "rigs" if nodeid.startswith(RIGS) else str(super()._split_scope(nodeid))


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> RigsTogether:
    return RigsTogether(config, log)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Lower the priority of a process, and of all that it starts, once it has no rigs before it."""
    if not item.nodeid.startswith(RIGS) and os.nice(0) < NICE:
        os.nice(NICE)
