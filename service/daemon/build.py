"""The composition root: every part of the daemon is built here, from the settings, and handed what it needs."""

import asyncio
import logging
import time
from dataclasses import asdict, replace

from pipeline.frames import FrameBundle
from pipeline.rig.cameras import RigCalibration
from service.acquisition.acquisition import Acquisition, AcquisitionParameters
from service.calibration.calibrations import Calibrations
from service.calibration.files import Activation, image_sizes_px
from service.calibration.verifications import Verification, Verifications
from service.configuration.segmentation_settings import plan_segmenter
from service.daemon.alarming import acquisition_changed, verification_ended
from service.daemon.heartbeats import Heartbeats, Watched
from service.daemon.loop_watch import LoopWatch
from service.daemon.lot_files import files_maker, issued_reports
from service.daemon.overview.overviews import KeptFigures
from service.daemon.overview.result_delays import ResultDelays
from service.daemon.parts import Deliveries, parts_of
from service.daemon.reloading import Configuration
from service.daemon.retaining import Retaining
from service.daemon.running_daemon import Daemon, Watches
from service.daemon.session import Session, begin_session
from service.daemon.shift_sheets import sheets_drop, sheets_maker
from service.daemon.stopping import StopRequests
from service.delivery.file_drop import open_file_drop
from service.delivery.mail import Mail
from service.delivery.webhooks import open_webhooks
from service.health.alarms.alarms import open_alarms
from service.health.optical_watch import OpticalWatch
from service.health.refinement_watch import RefinementWatch
from service.health.rig_watch import RigWatch
from service.health.segmentation_watch import SegmentationWatch
from service.processing.backgrounds import KeptBackground
from service.processing.measure_job import WorkerContext, prepare
from service.processing.processing import Processing, ProcessingContext, ProcessingObserver
from service.processing.segmenters import SegmenterPlan
from service.processing.spool import BundleFiles, Spool
from service.processing.worker_pool import WorkerPool
from service.recording.raw_archive import RawArchive
from service.recording.recordings import Recordings
from service.remeasuring.jobs import Jobs
from service.remeasuring.remeasuring import Remeasuring, new_pool
from service.results.fields import Result
from service.store import Store
from service.store.events import EventType, NewEvent
from service.store.keys import rename_file, take_over
from service.store.reads import gate_count
from service.store.writes import note_calibration
from service.web.key_ring import KeyRing
from service.web.reader_process import Reading

log = logging.getLogger(__name__)

ACQUISITION_SILENCE_S = 20.0
"""Longest time without progress of an active acquisition: that of opening and closing dead cameras."""
COMMIT_SILENCE_S = 30.0
WORKER_RETRY_S = 1.0
"""Longest time from the end of a bundle's second attempt to its outcome."""


async def build(configured: Configuration, store: Store, reading: Reading, requests: StopRequests) -> Daemon:
    """Build all parts, none of which runs yet.

    Of the triggers that a killed daemon left open, those whose bundle is still on tmpfs are measured; the others are
    recorded as lost.
    """
    session = await begin_session(configured.settings, store)
    rename_file(store.dir, await store.write(take_over, store.dir))
    settings = session.settings
    worker_context = await _worker_context(session)
    watches = _build_watches(session, worker_context.segmentation)
    made_by = {"command": "serve", "instance_id": store.instance_id, "session": session.number}
    recordings = await asyncio.to_thread(
        Recordings, store.dir / "recordings", session.source, settings.recordings, made_by
    )
    calibrations = await _open_calibrations(session, watches.rig, recordings)
    if (counted := await store.read(gate_count)) is not None:
        session.devices.gate.resume(*counted)
    spool, archive = _build_queue(session)
    pool = WorkerPool(
        slots=settings.workers.slots,
        deadline_s=settings.workers.deadline_s,
        prepare=prepare,
        context=worker_context,
        retry_s=WORKER_RETRY_S,
    )
    delays = ResultDelays()
    processing = _build_processing(session, watches, calibrations, spool, pool, delays)
    again = Jobs(
        store,
        calibrations.rig_file_of,
        lambda: processing.background,
        folder=session.folder / "again",
        save_silhouettes=settings.store.save_silhouettes,
    )
    retaining = Retaining(
        store, recordings, settings.store.retention, is_clock_sure=lambda: watches.loop.clock_step_s() is None
    )
    daemon = Daemon(
        configured=configured,
        session=session,
        watches=watches,
        keys=KeyRing(settings.api.keys, store),
        recordings=recordings,
        calibrations=calibrations,
        acquisition=_build_acquisition(session, watches, calibrations, recordings, spool),
        spool=spool,
        archive=archive,
        pool=pool,
        processing=processing,
        delays=delays,
        figures=KeptFigures(store, reading),
        remeasuring=Remeasuring(again, worker_context, new_pool(worker_context)),
        retaining=retaining,
        alarms=await open_alarms(store, session.events),
        webhooks=await open_webhooks(store, settings.webhooks),
    )
    file_drop = await open_file_drop(store, settings.file_drop)
    deliveries = Deliveries(
        drops=(
            (file_drop, files_maker),
            (issued_reports(store), files_maker),
            (sheets_drop(store, settings.file_drop), sheets_maker),
        ),
        mail=Mail(store, settings.mail),
    )
    daemon.parts.extend(parts_of(daemon, deliveries, reading, requests))
    return daemon


async def _worker_context(session: Session) -> WorkerContext:
    segmentation = await asyncio.to_thread(plan_segmenter, session.settings.segmentation)
    if segmentation.warning is not None:
        log.error("%s", segmentation.warning)
    return WorkerContext(
        parameters=replace(session.settings.pipeline, fall=session.source.fall),
        is_simulated=session.source.is_simulated,
        segmentation=segmentation,
        compact_meshes=not session.settings.store.exact_meshes,
        draws_thumbnails=True,
    )


def _build_watches(session: Session, segmentation: SegmenterPlan) -> Watches:
    return Watches(
        loop=LoopWatch(),
        progress=Heartbeats(
            {
                Watched.ACQUISITION: ACQUISITION_SILENCE_S,
                Watched.PROCESSING: 2 * session.settings.workers.deadline_s + COMMIT_SILENCE_S,
            }
        ),
        rig=RigWatch(session.calibrations.rig, session.source.fall),
        optics=OpticalWatch(session.configured_rig, session.settings.optics),
        segmentation=SegmentationWatch(segmentation),
        refinement=RefinementWatch(),
    )


async def _open_calibrations(session: Session, rig_watch: RigWatch, recordings: Recordings) -> Calibrations:
    loop, settings = asyncio.get_running_loop(), session.settings

    async def on_activated(rig: RigCalibration, activation: Activation) -> None:
        rig_watch.restart(rig)
        recordings.use_rig(rig)
        await session.store.write_soon(note_calibration, session.number, rig.calibration_id)
        activated = EventType.CALIBRATION_ACTIVATED
        session.events.note(NewEvent(type=activated, subject=activation.id, data=asdict(activation)))

    def on_ended(verification: Verification) -> None:
        loop.call_soon_threadsafe(session.events.note, verification_ended(verification))

    verifications = await asyncio.to_thread(
        Verifications, settings.store.dir / "verifications", settings.verification, on_ended
    )
    return Calibrations(session.calibrations, verifications, on_activated=on_activated)


def _build_queue(session: Session) -> tuple[Spool, RawArchive]:
    """Build the spool of bundles, and the archive that takes over the files of the newest stones."""
    settings, store, belt = session.settings, session.store, session.devices.belt
    n_ahead = 2 * settings.workers.slots  # bundles that keep the workers busy
    if belt is not None:
        # in fast pace a replay delivers a bundle for each one that is free again; the archive can take all of them
        belt.permit(max(1, min(n_ahead + 1, settings.spool.max_bundles - len(session.left))))
    files = BundleFiles(session.folder, on_free=belt.permit if belt is not None else lambda: None)
    archive = RawArchive(store, session.source.camera_ids, files.give_back, max_waiting=n_ahead)
    spool = Spool(
        files,
        max_bundles=settings.spool.max_bundles,
        camera_ids=session.source.camera_ids,
        archive=archive.take if settings.store.keep_raw > 0 else lambda path, seq: False,
        store_trouble=lambda: None if store.trouble is None else f"store: {store.trouble}",
        left=session.left,
    )
    return spool, archive


def _build_acquisition(
    session: Session, watches: Watches, calibrations: Calibrations, recordings: Recordings, spool: Spool
) -> Acquisition:
    settings = session.settings

    def on_bundle(bundle: FrameBundle) -> None:
        recordings.offer(bundle)
        spool.offer(bundle)

    return Acquisition(
        session.devices,
        AcquisitionParameters(
            session=session.number,
            bundling=settings.rig.bundling_for(settings.bundling),
            min_cameras=settings.views.min,
            empty_rig=settings.empty_rig,
        ),
        triggers=session.store,
        # a recording has the kind of each bundle
        is_ball=lambda: session.devices.belt is None and calibrations.wants_balls,
        on_bundle=on_bundle,
        on_progress=lambda: watches.progress.beat(Watched.ACQUISITION, time.monotonic()),
        on_state=lambda state, trouble: session.events.note(acquisition_changed(state, trouble)),
    )


def _build_processing(
    session: Session,
    watches: Watches,
    calibrations: Calibrations,
    spool: Spool,
    pool: WorkerPool,
    delays: ResultDelays,
) -> Processing:
    settings, belt = session.settings, session.devices.belt
    optics = settings.rig.optical_settings

    def on_result(record: Result) -> None:
        for watch in (watches.rig, watches.optics, watches.refinement):
            watch.feed(record)
        delays.note_stages(record.timings_ms)

    return Processing(
        ProcessingContext(
            session=session.number,
            camera_ids=session.source.camera_ids,
            is_simulated=session.source.is_simulated,
            save_silhouettes=settings.store.save_silhouettes,
            folder=session.folder,
            checked=False,  # this process has just written the pixels
            # without real time the belt waits for each bundle, and a replay gives equal results each time
            can_rush=belt is None or belt.pace == "recorded",
            # it outlives the daemon, but in replay, where only the recording counts
            kept_background=None
            if optics is None
            else KeptBackground(session.store.dir, image_sizes_px(session.configured_rig), optics),
        ),
        spool=spool,
        pool=pool,
        finish=session.store.finish,
        calibration=calibrations.in_use,
        observer=ProcessingObserver(
            on_progress=lambda: watches.progress.beat(Watched.PROCESSING, time.monotonic()),
            on_empty_rig=watches.optics.feed_optics,
            on_result=on_result,
            on_measured=watches.segmentation.feed,
            # a replay has a clock of its own
            on_outcome=delays.note if belt is None else lambda delay_s: None,
            on_stored=lambda took_s: delays.note_stages({"store": took_s * 1e3}),
        ),
        quarantine=session.quarantine,
    )
