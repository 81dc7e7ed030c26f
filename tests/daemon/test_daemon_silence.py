"""The daemon talks to nobody but its rig and its clients: no library in it calls its maker."""

import subprocess
from pathlib import Path

import pytest
from support.daemon_process import STONEFALL, DaemonProcess
from support.networks import difference_network
from support.small_recording import write_small_recording

COUNTERS = {"Ip": ["OutNoRoutes"], "Udp": ["OutDatagrams"], "Tcp": ["ActiveOpens"]}
"""What counts each packet that leaves, and each that would have, had there been a way out."""
ALONE = ("unshare", "--map-root-user", "--net")
"""Runs a command in a network of its own, which has no way out."""


def sent_by(pid: int) -> dict[str, int]:
    """Return the counters of the network that a process is in."""
    found = {}
    lines = Path(f"/proc/{pid}/net/snmp").read_text().splitlines()
    for names, values in zip(lines[::2], lines[1::2], strict=True):
        layer, *columns = names.split()
        counts = dict(zip(columns, values.split()[1:], strict=True))
        found |= {name: int(counts[name]) for name in COUNTERS.get(layer.rstrip(":"), [])}
    return found


@pytest.mark.full
def test_nothing_leaves_while_a_network_runs_and_a_stone_is_measured(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "recording", n_stones=2)
    (tmp_path / "net.onnx").write_bytes(difference_network("n"))
    (tmp_path / "home").mkdir()
    is_alone = subprocess.run([*ALONE, "true"], check=False).returncode == 0  # some containers forbid it
    with DaemonProcess(
        tmp_path,
        tmp_path / "recording",
        segmentation='model = "net.onnx"\nsegmenter = "onnx"',
        command=(
            "env",
            "-u",
            "XDG_CACHE_HOME",
            f"HOME={tmp_path}/home",
            *(ALONE if is_alone else ()),
            STONEFALL,
        ),
    ) as daemon:
        daemon.hear("READY=1")
        daemon.hear("STATUS=disarmed, 0 bundles waiting, last result 2")
        if is_alone:
            assert sent_by(daemon.process.pid) == {"OutNoRoutes": 0, "OutDatagrams": 0, "ActiveOpens": 0}
        assert daemon.stop() == 0
    assert "Traceback" not in daemon.log
    assert list((tmp_path / "home").rglob("*")) == []  # a device id, a queue of reports
