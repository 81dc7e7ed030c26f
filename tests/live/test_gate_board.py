"""A stone's whole way with the gate one can build: its firmware on an emulated board triggers simulated cameras."""

from pathlib import Path

import pytest
from support.daemon_process import DaemonProcess
from support.emulated_board import US, BoardOnPort, Build, running
from support.live_rig import LiveRig, live_section, own_address
from support.small_recording import write_small_recording

from drivers.files.recording import open_recording
from drivers.gige_simulator.gate import SimulatedGateCounters
from drivers.gige_simulator.rig import RigDesign, SimulatedRig

N_STONES = 4
N_TRIES = 5
"""A machine on which other tests run may lose a stone, as its frames come too late, but not in each try."""


class BoardGate(BoardOnPort):
    """The board in the place of the simulated rig's own gate."""

    counters = SimulatedGateCounters()


@pytest.mark.full
def test_stones_that_fall_are_exposed_by_the_boards_pulses_and_measured(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    recording = tmp_path / "recording"
    write_small_recording(recording, n_stones=3)
    design = RigDesign(
        gate_link=tmp_path / "gate", first_address=own_address(9), is_looping=True, only_stones=True
    )
    rig = SimulatedRig(design, open_recording(recording))

    def pulse(at_ns: int) -> None:
        for camera in rig.cameras.values():
            camera.line(at_ns=at_ns)

    with running(Build.make(tmp_path_factory.mktemp("firmware"))) as board:
        rig.gate = BoardGate(board, design.gate_link, pulse=pulse)  # type: ignore[assignment]  # asks no more
        with rig:
            section = live_section(
                rig, tmp_path, recording, by_address=True, more='delay = "gate"', at_start=2
            )
            with DaemonProcess(tmp_path, recording, rig=section) as daemon:
                daemon.hear("READY=1")
                live = LiveRig(rig, daemon)
                live.wait_until_whole()
                daemon.wait_for("/accounting", lambda counts: counts["backgrounds"] == 2)
                for _ in range(N_TRIES):
                    before = live.last_seq()
                    live.fall(N_STONES, spacing_s=0.06)
                    results = live.wait_for_results(before, N_STONES)
                    if all(result["outcome"] == "measured" for result in results):
                        break
                assert [result["outcome"] for result in results] == ["measured"] * N_STONES
                assert daemon.stop() == 0
        closings = board.rises("beam")
        pulses = board.rises("trigger")[-len(closings) :]
    delays_us = {round((rise - close) / US) for close, rise in zip(closings, pulses, strict=True)}
    assert len(delays_us) == 1
    assert 247_000 < delays_us.pop() < 248_000
