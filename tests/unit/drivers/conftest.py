"""A simulated camera for the tests of what it says and sends."""

from collections.abc import Iterator

import pytest
from support.simulated_camera import Session, session


@pytest.fixture
def camera() -> Iterator[Session]:
    """Switched on, controlled by the test."""
    with session() as opened:
        yield opened
