"""The daemon's start brings nothing that only some requests or calibrations need: half a second of each."""

import subprocess
import sys

import pytest

LATER = ("trimesh", "networkx", "scipy.optimize", "scipy.ndimage", "skimage.measure", "pipeline.synthesis")


def test_what_is_needed_later_is_imported_later() -> None:
    code = f"import sys, service.daemon.build; print([name for name in {LATER} if name in sys.modules])"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.strip() == "[]"


@pytest.mark.full
def test_what_workers_are_forked_from_has_no_thread_and_no_network() -> None:
    code = (
        "import os, sys, service.processing.worker_imports\n"
        "print(len(os.listdir('/proc/self/task')), 'onnxruntime' in sys.modules, 'numba' in sys.modules)"
    )
    printed = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={"OPENBLAS_NUM_THREADS": "1"},
    ).stdout
    assert printed.split() == ["1", "False", "True"]
