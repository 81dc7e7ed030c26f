"""A session of the simulated camera with the real Aravis, as Wireshark's dissectors see it.

The standard is not public: that Aravis accepts and Wireshark dissects what the simulator sends is the evidence.
"""

import json
import os
import select
import socket
import struct
import subprocess
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.aravis_stream import AravisStream, opened
from support.eventually import eventually
from support.gige_client import DISCOVERY, READMEM, READREG, RESEND, Application, application
from support.simulated_camera import picture

from drivers.gige_simulator.camera import CameraDesign, SimulatedCamera
from pipeline.frames import CameraId

ADDRESS = f"127.35.{os.getpid() % 256}.77"
SIZE_PX = (128, 96)
N_PIXELS = SIZE_PX[0] * SIZE_PX[1]
SCPD = 0xD08
UNKNOWN_ADDRESS = 0x1FFFC
INVALID_ADDRESS, ACCESS_DENIED = 0x8003, 0x8006
N_FRAMES = 3
PCAP_HEADER_BYTES = 24
BEGIN, END = b"begin of the session", b"end of the session"
NOBODY = 9
"""Port of the packets that begin and end a session."""


@contextmanager
def _captured(path: Path) -> Iterator[None]:
    """Capture what this camera sends and gets over loopback into `path`, to the last packet."""
    command = ["dumpcap", "-q", "-P", "-i", "lo", "-f", f"udp and host {ADDRESS}", "-w", "-"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as dumpcap:
        assert dumpcap.stdout is not None
        assert dumpcap.stderr is not None
        try:
            head = dumpcap.stdout.read(PCAP_HEADER_BYTES)  # written once it captures
            assert head, f"dumpcap cannot capture on lo, run as root or setcap it: {dumpcap.stderr.read()!r}"
            captured = bytearray(head)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                while BEGIN not in captured:
                    sender.sendto(BEGIN, (ADDRESS, NOBODY))
                    if select.select([dumpcap.stdout], [], [], 0.1)[0]:
                        captured += dumpcap.stdout.read1()
                yield
                sender.sendto(END, (ADDRESS, NOBODY))
            while END not in captured[-4096:]:
                chunk = dumpcap.stdout.read1()
                assert chunk, "dumpcap ended"
                captured += chunk
            path.write_bytes(captured)
        finally:
            dumpcap.kill()
            dumpcap.communicate()


def _dissected(path: Path, stream_port: int) -> list[dict[str, Any]]:
    """Layers of every packet but those that began and ended the capture."""
    command = ["tshark", "-r", str(path), "-d", f"udp.port=={stream_port},gvsp", "-T", "json"]
    command += ["-Y", f"udp.dstport != {NOBODY}"]
    tshark = subprocess.run(command, capture_output=True, text=True, check=True)
    return [row["_source"]["layers"] for row in json.loads(tshark.stdout)]


def _session(simulated: SimulatedCamera, *, extended_ids: bool, chunks: bool) -> None:
    """Open, negotiate, set, acquire with a lost packet, be refused, leave."""
    with opened(ADDRESS) as camera:
        camera.gv_auto_packet_size()
        camera.gv_set_packet_size(1500)
        camera.set_trigger("Line1")
        camera.set_exposure_time(200.0)
        camera.set_string("GevGVSPExtendedIDMode", "On" if extended_ids else "Off")
        camera.set_chunk_mode(chunks)
        with AravisStream(camera) as stream:
            simulated.faults.lost_packets = (2,)
            for n in range(1, N_FRAMES + 1):
                simulated.line()
                popped = stream.pop()
                assert popped is not None
                assert popped[:2] == ("success", n)
            with application(ADDRESS) as other:
                assert other.write(SCPD, 1) == other.write_memory(SCPD, bytes(4)) == ACCESS_DENIED
                assert other.ask(READREG, struct.pack(">I", UNKNOWN_ADDRESS))[0] == INVALID_ADDRESS
                assert other.ask(READMEM, struct.pack(">IHH", UNKNOWN_ADDRESS, 0, 4))[0] == INVALID_ADDRESS
                assert other.ask(DISCOVERY)[0] == 0
                _ask_for_what_is_gone(other, extended_ids=extended_ids)
            eventually(lambda: simulated.counters.unavailable == 1)


def _ask_for_what_is_gone(other: Application, *, extended_ids: bool) -> None:
    if extended_ids:
        other.tell(RESEND, struct.pack(">IIIQ", 0, 0, 0, 99), flags=0x10)
    else:
        other.tell(RESEND, struct.pack(">HHII", 0, 99, 0, 0))


def _kind_of(gvcp: str) -> str:
    for kind, field in (
        ("resend", f'"gvcp.cmd.command": "0x{RESEND:04x}"'),
        ("discovery", f'"gvcp.cmd.command": "0x{DISCOVERY:04x}"'),
        ("discovery acknowledgement", f'"gvcp.ack": "0x{DISCOVERY + 1:04x}"'),
        ("command", '"gvcp.cmd.command"'),
    ):
        if field in gvcp:
            return kind
    return "acknowledgement"


@pytest.mark.parametrize("chunks", [False, True])
@pytest.mark.parametrize("extended_ids", [False, True])
def test_wireshark_understands_every_packet(tmp_path: Path, *, extended_ids: bool, chunks: bool) -> None:
    simulated = SimulatedCamera(
        CameraDesign(id=CameraId("c01"), address=ADDRESS, serial="SIM01", image_size_px=SIZE_PX),
        lambda exposure: picture(exposure.n),
    )
    simulated.start()
    try:
        stream_port = simulated.stream_port
        with _captured(tmp_path / "session.pcap"):
            _session(simulated, extended_ids=extended_ids, chunks=chunks)
        counters = simulated.counters
    finally:
        simulated.stop()
    seen: Counter[str] = Counter()
    for layers in _dissected(tmp_path / "session.pcap", stream_port):
        assert "_ws.malformed" not in json.dumps(layers), layers
        if gvsp := layers.get("gvsp"):
            seen[f"{int(gvsp['gvsp.format'], 16) & 0x7F} {gvsp['gvsp.status']}"] += 1
            assert (int(gvsp["gvsp.format"], 16) >= 0x80) is extended_ids or gvsp["gvsp.format"] == "0x00"
        else:
            assert "gvcp" in layers, layers["frame"]["frame.protocols"]
            seen[_kind_of(json.dumps(layers))] += 1
    n_payload = -(-(N_PIXELS + (8 + 4 * 16) * chunks) // (1500 - (48 if extended_ids else 36)))
    assert seen.pop("0 0x0000") > 2  # test packets
    assert seen.pop("command") == seen.pop("acknowledgement")
    assert (
        seen.pop("discovery acknowledgement") >= seen.pop("discovery") == 1
    )  # others on this machine may ask as well
    n_resends = seen.pop("resend")  # of the lost packets, and of one that is gone
    assert counters.packets == seen.total()
    expected = {"1 0x0000": N_FRAMES, "2 0x0000": N_FRAMES, "3 0x0000": N_FRAMES * n_payload, "3 0x800c": 1}
    if n_resends == N_FRAMES + 1:
        assert seen == expected
    else:  # a busy machine asks again for what is only late
        assert n_resends > N_FRAMES + 1
        assert seen.keys() == expected.keys()
        assert all(seen[each] >= n for each, n in expected.items())
