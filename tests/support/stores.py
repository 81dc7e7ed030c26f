"""Fixtures: an empty store with one session."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from service.store import Store, open_store


def folder_of(state_dir: Path, name: str) -> Path:
    """Return the folder of a particle's files."""
    return next(state_dir.glob(f"particles/*/{name}"))


@pytest.fixture
def state_dir(tmp_path: Path) -> Path:
    return tmp_path / "state"


@pytest.fixture
def store(state_dir: Path) -> Iterator[Store]:
    with open_store(state_dir) as store:
        yield store


@pytest.fixture
async def session(store: Store) -> int:
    return await store.begin_session({"calibration_id": "0123", "is_simulated": True})
