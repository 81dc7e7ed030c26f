"""Errors of devices and files survive the way home from a worker process."""

import pickle
from pathlib import Path

import pytest

from drivers.errors import CameraUnavailableError, DriverError, LossCause, RecordingError


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (CameraUnavailableError("c01", "does not answer", LossCause.SILENT), "c01: does not answer"),
        (RecordingError(Path("rec/rig.json"), "is not JSON"), "rec/rig.json: is not JSON"),
    ],
)
def test_an_error_can_be_pickled(error: DriverError, text: str) -> None:
    back = pickle.loads(pickle.dumps(error))  # noqa: S301 - made on the line above
    assert str(back) == text
    assert vars(back) == vars(error)
