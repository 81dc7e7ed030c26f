"""One run of the daemon: what it begins with, and what it takes over from one that was killed."""

import asyncio
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.factory import Devices, build_devices
from drivers.files.recording import RecordingSource
from drivers.files.rig_file import read_rig
from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration
from service.calibration.startup import CalibrationsAtStart, load_calibrations
from service.configuration.settings import Settings
from service.processing.left_bundles import Quarantine, bundles_in, take_over
from service.processing.spool import LeftBundle
from service.results.fields import LossReason
from service.results.version import ALGORITHM_VERSION
from service.store import Store
from service.store.event_log import EventLog
from service.store.reads import open_triggers
from service.store.writes import lose_open

log = logging.getLogger(__name__)

LOST_EVERY_S = 0.5
"""Pause between two steps of recording what a killed daemon left open: processor and disk are for what falls now."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """Everything that a run of the daemon begins with: store, devices, calibration, bundles left by a killed one."""

    settings: Settings
    """Settings of the start; `Daemon.settings` are those in use now."""
    store: Store
    events: EventLog
    number: int
    devices: Devices
    configured_rig: RigCalibration
    calibrations: CalibrationsAtStart
    source: RecordingSource
    folder: Path
    """On tmpfs, for bundles and for the workers' files."""
    quarantine: Quarantine
    left: Sequence[LeftBundle]
    """Bundles of a killed daemon that are to be measured."""


async def begin_session(settings: Settings, store: Store) -> Session:
    """Begin a session in the store and on tmpfs; what a killed daemon left and cannot be measured is lost."""
    configured_rig = await asyncio.to_thread(read_rig, settings.rig.calibration_path)
    devices = await asyncio.to_thread(build_devices, settings.rig.backend_for(configured_rig))
    calibrations = await asyncio.to_thread(
        load_calibrations, settings.store.dir / "calibrations", configured_rig
    )
    source = settings.rig.source(devices, calibrations.rig)
    number = await store.begin_session(
        {
            "calibration_id": calibrations.rig.calibration_id,
            "algorithm_version": ALGORITHM_VERSION,
            "is_simulated": source.is_simulated,
            "is_replay": source.is_simulated or devices.belt is not None,
            **settings.rig.describe(),
        }
    )
    spool_folder = settings.spool.dir / store.instance_id  # daemons with other stores keep theirs
    quarantine = Quarantine(settings.store.dir / "quarantine")
    return Session(
        settings=settings,
        store=store,
        events=EventLog(store),
        number=number,
        devices=devices,
        configured_rig=configured_rig,
        calibrations=calibrations,
        source=source,
        folder=spool_folder / str(number),
        quarantine=quarantine,
        left=await _take_over(store, number, spool_folder, source.camera_ids, quarantine),
    )


async def _take_over(
    store: Store, session: int, folder: Path, camera_ids: Sequence[CameraId], quarantine: Quarantine
) -> list[LeftBundle]:
    """Create the spool of this session; return what a killed daemon left to measure, and record the first losses.

    The others are recorded beside what falls now: there may be thousands, and nothing waits for them.
    """
    left_open = await store.read(open_triggers, store.session, await asyncio.to_thread(bundles_in, folder))
    left = await asyncio.to_thread(take_over, folder, session, left_open, camera_ids, quarantine)
    lost = await _lose_crashed(store, left)
    if lost or left:
        log.error("the daemon had crashed triggers_lost=%d bundles_to_measure=%d", lost, len(left))
    return left


async def lose_all_crashed(store: Store, left: Sequence[LeftBundle]) -> None:
    """Record what a killed daemon did not measure, a step at a time; the next start goes on with the rest."""
    while n_stones := await _lose_crashed(store, left):
        log.error("the daemon had crashed triggers_lost=%d", n_stones)
        await asyncio.sleep(LOST_EVERY_S)


async def _lose_crashed(store: Store, left: Sequence[LeftBundle]) -> int:
    """Record a step of what a killed daemon did not measure, but what is `left`, as lost; return of how many stones."""
    detail, but = (
        "the daemon ended before this bundle was measured",
        {(each.session, each.name) for each in left},
    )
    return await store.write(lose_open, store.particles_dir, store.session, LossReason.CRASH, detail, but)
