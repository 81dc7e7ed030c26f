"""A live rig whose cameras turn out to be simulated, though nothing in its configuration says so."""

from contextlib import closing
from pathlib import Path

import pytest
from support.daemon_process import PATIENCE_S, DaemonProcess
from support.live_rig import LiveRig, live_section, simulated_rig
from support.outcomes import add, measured
from support.small_recording import write_small_recording

from service.store import open_store


async def write_live_result(state_dir: Path) -> None:
    with closing(open_store(state_dir)) as store:
        session = await store.begin_session({"cameras": ["c01"], "is_simulated": False, "is_replay": False})
        await add(store, session, 1, measured(), {})


@pytest.mark.full
@pytest.mark.parametrize("by_address", [True, False])
async def test_results_of_simulated_cameras_are_marked_and_never_beside_those_of_stones_that_fell(
    by_address: bool, tmp_path: Path
) -> None:
    recording, plant = tmp_path / "recording", tmp_path / "plant"
    write_small_recording(recording, n_stones=3)
    with simulated_rig(tmp_path, recording, number=7) as rig:
        section = live_section(rig, tmp_path, recording, by_address=by_address)
        section = section.replace("is_simulated = true\n", "")
        with DaemonProcess(tmp_path, recording, rig=section) as daemon:
            daemon.hear("READY=1")
            live = LiveRig(rig, daemon)
            live.wait_until_whole()
            results = live.measure(2)
            assert daemon.stop() == 0
        assert all(result["is_simulated"] and result["is_replay"] for result in results)
        plant.mkdir()
        await write_live_result(plant / "state")
        with DaemonProcess(plant, recording, rig=section) as daemon:
            assert daemon.process.wait(PATIENCE_S) == 1
            assert "the store holds the results of stones that fell: choose another store.dir" in daemon.log
