"""A model that cannot be used is no reason to stop: stones are measured without it, and everybody is told."""

from pathlib import Path

import pytest
from support.daemon_process import DaemonProcess
from support.small_recording import write_small_recording


@pytest.mark.full
def test_a_damaged_model_is_named_and_done_without(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "recording", n_stones=1)
    (tmp_path / "net.onnx").write_bytes(b"damaged")
    with DaemonProcess(
        tmp_path, tmp_path / "recording", segmentation='model = "net.onnx"', slots=1
    ) as daemon:
        daemon.hear("READY=1")
        daemon.hear_line(f"classical mode: {tmp_path / 'net.onnx'}: expected an ONNX model")
        daemon.wait_for("/accounting", lambda now: now["measured"] == 1)
        (result,) = daemon.results()
        assert (result["outcome"], result["quality"]) == ("measured", "good")
        assert result["segmenters"] == dict.fromkeys(result["views"], "background")
        assert result["segmentation_flags"] == dict.fromkeys(result["views"], "no model")
        check = daemon.check("segmentation", lambda now: now["status"] == "warn")
        assert check["detail"].startswith(f"classical mode: {tmp_path / 'net.onnx'}: expected an ONNX model")
        assert daemon.stop() == 0
