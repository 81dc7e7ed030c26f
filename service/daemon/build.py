"""The composition root: every part of the daemon is built here, from the settings, and handed what it needs."""

import asyncio
import logging
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from drivers.factory import Devices, build_devices
from drivers.files.rig_file import read_rig
from drivers.replay.belt import ReplayBelt
from pipeline.frames import CameraId, FrameBundle
from pipeline.rig.cameras import RigCalibration
from service.acquisition.acquisition import Acquisition
from service.api.key_ring import KeyRing
from service.api.metrics import result_delays
from service.calibration.calibrations import Calibrations
from service.calibration.files import Activation, image_sizes_px
from service.calibration.startup import CalibrationsAtStart, load_calibrations
from service.calibration.verifications import Verification, open_verifications
from service.configuration.segmentation_settings import plan_segmenter
from service.configuration.settings import Settings
from service.daemon.alarming import Alarming, acquisition_changed, verification_ended
from service.daemon.backing_up import BackingUp
from service.daemon.heartbeats import Heartbeats, Watched
from service.daemon.loop_watch import LoopWatch
from service.daemon.part import Part
from service.daemon.reloading import Configuration
from service.daemon.retaining import Retaining
from service.daemon.running_daemon import Daemon, Watches
from service.delivery.file_drop import open_file_drop
from service.delivery.webhooks import open_webhooks
from service.health.alarms.alarms import open_alarms
from service.health.optical_watch import OpticalWatch
from service.health.refinement_watch import RefinementWatch
from service.health.rig_watch import RigWatch
from service.health.segmentation_watch import SegmentationWatch
from service.processing.background_keeping import KeptBackground
from service.processing.bundle_files import BundleFiles
from service.processing.left_bundles import LeftBundle, bundles_in, take_over
from service.processing.measure_job import WorkerContext, prepare
from service.processing.observers import WatchedResults
from service.processing.processing import Processing, ProcessingContext, background_check
from service.processing.quarantine import Quarantine
from service.processing.spool import Spool
from service.processing.worker_pool import WorkerPool
from service.recording.live_recording import RecordingSource
from service.recording.raw_archive import RawArchive
from service.recording.recordings import Recordings, open_recordings
from service.remeasuring.remeasuring import Remeasuring, new_pool
from service.results.fields import LossReason
from service.results.version import ALGORITHM_VERSION
from service.store import Store
from service.store.checks import store_checks
from service.store.event_log import EventLog
from service.store.events import EventType, NewEvent

log = logging.getLogger(__name__)

ACQUISITION_SILENCE_S = 20.0
"""Longest time without progress of an active acquisition: that of opening and closing dead cameras."""
COMMIT_SILENCE_S = 30.0
WORKER_RETRY_S = 1.0
"""Longest time from the end of a bundle's second attempt to its outcome."""

N_LATEST = 100
"""Outcomes whose delays are remembered one by one."""


async def build(configured: Configuration, store: Store) -> Daemon:
    """Build all parts, none of which runs yet.

    Of the triggers that a killed daemon left open, those whose bundle is still on tmpfs are measured; the others are
    recorded as lost.
    """
    settings = configured.settings
    initial_rig = await asyncio.to_thread(read_rig, settings.rig.calibration_path)
    devices = await asyncio.to_thread(build_devices, settings.rig.backend_for(initial_rig))
    found = await asyncio.to_thread(load_calibrations, settings.store.dir / "calibrations", initial_rig)
    source = settings.rig.source(devices, found.rig)
    session = await _begin_session(settings, store, devices, source, found)
    spool_folder = settings.spool.dir / store.instance_id  # daemons with other stores keep theirs
    quarantine = Quarantine(settings.store.dir / "quarantine")
    left = await _take_over(store, session, spool_folder, source.camera_ids, quarantine)
    folder = spool_folder / str(session)

    segmentation = await asyncio.to_thread(plan_segmenter, settings.segmentation)
    if segmentation.warning is not None:
        log.error("%s", segmentation.warning)
    heartbeats = Heartbeats(
        {
            Watched.ACQUISITION: ACQUISITION_SILENCE_S,
            Watched.PROCESSING: 2 * settings.workers.deadline_s + COMMIT_SILENCE_S,
        }
    )
    watches = Watches(
        loop=LoopWatch(),
        rig=RigWatch(found.rig, source.fall),
        optics=OpticalWatch(initial_rig, settings.optics),
        segmentation=SegmentationWatch(segmentation),
        refinement=RefinementWatch(),
    )
    recordings = await asyncio.to_thread(_open_recordings, settings, store, source, session)
    events = EventLog(store)
    calibrations = await _open_calibrations(settings, store, events, found, session, watches.rig, recordings)
    if (counted := await store.gate_count()) is not None:
        devices.gate.resume(*counted)
    spool, archive = _build_queue(settings, store, source, devices.belt, folder, left)

    def on_bundle(bundle: FrameBundle) -> None:
        recordings.offer(bundle)
        spool.offer(bundle)

    acquisition = Acquisition(
        devices,
        session=session,
        triggers=store,
        bundling=settings.rig.bundling_for(settings.bundling),
        min_cameras=settings.views.min,
        empty_rig=settings.empty_rig,
        # a recording has the kind of each bundle
        is_ball=lambda: devices.belt is None and calibrations.wants_balls,
        on_bundle=on_bundle,
        on_progress=lambda: heartbeats.beat(Watched.ACQUISITION, time.monotonic()),
        store_trouble=lambda: _store_trouble(store),
        on_state=lambda state, trouble: events.note(acquisition_changed(state, trouble)),
    )
    worker_context = WorkerContext(
        parameters=settings.pipeline,
        is_simulated=source.is_simulated,
        speed_at_gate_mm_s=source.fall.speed_at_gate_mm_s,
        segmentation=segmentation,
        compact_meshes=not settings.store.exact_meshes,
    )
    pool = WorkerPool(
        slots=settings.workers.slots,
        deadline_s=settings.workers.deadline_s,
        prepare=prepare,
        context=worker_context,
        retry_s=WORKER_RETRY_S,
    )
    delays, latest_delays_s = result_delays(), deque[float](maxlen=N_LATEST)

    def on_outcome(delay_s: float) -> None:
        if devices.belt is None:  # a replay has a clock of its own
            delays.observe(delay_s)
            latest_delays_s.append(delay_s)

    processing = Processing(
        ProcessingContext(
            session=session,
            camera_ids=source.camera_ids,
            is_simulated=source.is_simulated,
            save_silhouettes=settings.store.save_silhouettes,
            folder=folder,
            checked=False,  # this process has just written the pixels
            # without real time the belt waits for each bundle, and a replay gives equal results each time
            can_rush=devices.belt is None or devices.belt.pace == "recorded",
        ),
        spool=spool,
        pool=pool,
        results=WatchedResults(store, watches.rig, watches.optics, watches.refinement),
        calibration=calibrations,
        kept_background=_kept_background(settings, initial_rig),
        quarantine=quarantine,
        on_empty_rig=watches.optics.feed_optics,
        on_network=watches.segmentation.feed,
        on_progress=lambda: heartbeats.beat(Watched.PROCESSING, time.monotonic()),
        on_outcome=on_outcome,
    )
    keys = KeyRing(settings.api.keys, settings.store.dir)
    backing_up = BackingUp(store, every_h=settings.store.backup_every_h, keep=settings.store.keep_backups)
    retaining = Retaining(
        store,
        recordings,
        settings.store.retention,
        is_clock_sure=lambda: watches.loop.clock_step_s() is None,
    )
    alarms = await open_alarms(store, events)
    webhooks = await open_webhooks(store, settings.webhooks)
    file_drop = await open_file_drop(store, settings.file_drop)
    has_network = segmentation.model is not None
    return Daemon(
        configured=configured,
        store=store,
        keys=keys,
        devices=devices,
        session=session,
        calibrations=calibrations,
        folder=folder,
        pool=pool,
        spool=spool,
        left=left,
        recordings=recordings,
        archive=archive,
        backing_up=backing_up,
        retaining=retaining,
        alarming=Alarming(alarms, events),
        webhooks=webhooks,
        file_drop=file_drop,
        acquisition=acquisition,
        processing=processing,
        remeasuring=Remeasuring(
            store,
            calibrations,
            processing,
            context=worker_context,
            make_pool=lambda: new_pool(worker_context),
            folder=folder,
            save_silhouettes=settings.store.save_silhouettes,
        ),
        delays=delays,
        latest_delays_s=latest_delays_s,
        heartbeats=heartbeats,
        watches=watches,
        parts=(
            Part(checks=watches.loop.checks),
            Part(checks=lambda: {"progress": heartbeats.check(time.monotonic())}),
            Part(checks=archive.checks),
            Part(checks=backing_up.checks),
            Part(checks=retaining.checks),
            Part(checks=webhooks.checks),
            Part(checks=file_drop.checks),
            Part(checks=lambda: store_checks(store, spool.n_waiting)),
            Part(checks=spool.checks),
            Part(checks=pool.checks),
            Part(checks=quarantine.checks),
            Part(
                checks=lambda: {
                    "background": background_check(
                        has_background=processing.has_background, has_network=has_network
                    )
                }
            ),
            Part(checks=watches.segmentation.checks),
            Part(checks=watches.rig.checks),
            Part(checks=watches.optics.checks),
            Part(checks=watches.refinement.checks),
            Part(checks=keys.checks),
            Part(checks=recordings.checks),
            Part(checks=calibrations.checks),
            Part(checks=acquisition.checks),
            Part(checks=configured.checks),
        ),
    )


def _store_trouble(store: Store) -> str | None:
    """Return why nothing can be stored, in words, None if results can be."""
    return None if store.trouble is None else f"store: {store.trouble}"


def _build_queue(
    settings: Settings,
    store: Store,
    source: RecordingSource,
    belt: ReplayBelt | None,
    folder: Path,
    left: Sequence[LeftBundle],
) -> tuple[Spool, RawArchive]:
    """Build the spool of bundles, and the archive that takes over the files of the newest stones."""
    n_ahead = 2 * settings.workers.slots  # bundles that keep the workers busy
    if belt is not None:
        # in fast pace a replay delivers a bundle for each one that is free again; the archive can take all of them
        belt.permit(max(1, min(n_ahead + 1, settings.spool.max_bundles - len(left))))
    files = BundleFiles(folder, on_free=belt.permit if belt is not None else lambda: None)
    archive = RawArchive(store, source.camera_ids, files.give_back, max_waiting=n_ahead)
    spool = Spool(
        files,
        max_bundles=settings.spool.max_bundles,
        camera_ids=source.camera_ids,
        archive=archive if settings.store.keep_raw > 0 else None,
        store_trouble=lambda: _store_trouble(store),
        left=left,
    )
    return spool, archive


async def _begin_session(
    settings: Settings, store: Store, devices: Devices, source: RecordingSource, found: CalibrationsAtStart
) -> int:
    """Begin a session in the store."""
    return await store.begin_session(
        {
            "calibration_id": found.rig.calibration_id,
            "algorithm_version": ALGORITHM_VERSION,
            "is_simulated": source.is_simulated,
            "is_replay": source.is_simulated or devices.belt is not None,
            **settings.rig.describe(),
        }
    )


async def _take_over(
    store: Store, session: int, folder: Path, camera_ids: Sequence[CameraId], quarantine: Quarantine
) -> list[LeftBundle]:
    """Create the spool of this session; return what a killed daemon left to measure, and record the first losses.

    The others are recorded beside what falls now: there may be thousands, and nothing waits for them.
    """
    open_triggers = await store.open_triggers(await asyncio.to_thread(bundles_in, folder))
    left = await asyncio.to_thread(take_over, folder, session, open_triggers, camera_ids, quarantine)
    lost = await lose_crashed(store, left)
    if lost or left:
        log.error("the daemon had crashed triggers_lost=%d bundles_to_measure=%d", lost, len(left))
    return left


async def lose_crashed(store: Store, left: Sequence[LeftBundle]) -> int:
    """Record a step of what a killed daemon did not measure, but what is `left`, as lost; return of how many stones."""
    return await store.lose_open(
        LossReason.CRASH,
        "the daemon ended before this bundle was measured",
        but={(bundle.session, bundle.name) for bundle in left},
    )


def _open_recordings(settings: Settings, store: Store, source: RecordingSource, session: int) -> Recordings:
    made_by = {"command": "serve", "instance_id": store.instance_id, "session": session}
    return open_recordings(settings.store.dir / "recordings", source, settings.recordings, made_by)


async def _open_calibrations(
    settings: Settings,
    store: Store,
    events: EventLog,
    found: CalibrationsAtStart,
    session: int,
    rig_watch: RigWatch,
    recordings: Recordings,
) -> Calibrations:
    loop = asyncio.get_running_loop()

    async def on_activated(rig: RigCalibration, activation: Activation) -> None:
        rig_watch.restart(rig)
        recordings.use_rig(rig)
        await store.note_calibration(session, rig.calibration_id)
        activated = EventType.CALIBRATION_ACTIVATED
        events.note(NewEvent(type=activated, subject=activation.id, data=asdict(activation)))

    def on_ended(verification: Verification) -> None:
        loop.call_soon_threadsafe(events.note, verification_ended(verification))

    verifications = await asyncio.to_thread(
        open_verifications, settings.store.dir / "verifications", settings.verification, on_ended
    )
    return Calibrations(found, verifications, on_activated=on_activated)


def _kept_background(settings: Settings, configured: RigCalibration) -> KeptBackground | None:
    """Return the background that outlives the daemon, None in replay, where only the recording counts."""
    optical_settings = settings.rig.optical_settings
    if optical_settings is None:
        return None
    return KeptBackground(settings.store.dir, image_sizes_px(configured), optical_settings)
