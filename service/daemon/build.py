"""The composition root: builds the parts, runs them in one task group, ends them in order.

The first SIGTERM or SIGINT stops the rig, measures what it has seen and exits 0; the second one gives up
what is not measured yet. Whatever a part cannot handle ends the group, and with it the process.
"""

import asyncio
import logging
import shutil
import time
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path

from drivers.factory import build_devices
from drivers.files.rig_file import read_rig
from pipeline.fall import speed_mm_s
from pipeline.frames import FrameBundle
from pipeline.rig.cameras import RigCalibration
from service.acquisition.session import Acquisition
from service.api.app import create_app
from service.api.server import RestServer, listen, server_config
from service.calibration.files import image_sizes_px
from service.calibration.sessions import Calibrations
from service.calibration.startup import find_calibrations
from service.calibration.verifications import open_verifications
from service.configuration.segmentation_settings import plan_segmenter
from service.configuration.settings import Settings
from service.daemon.heartbeats import Heartbeats
from service.daemon.loop_watch import LoopWatch
from service.daemon.running_daemon import Daemon
from service.daemon.stopping import StopRequests, finish
from service.daemon.systemd import ServiceManager, feed_watchdog
from service.health.optical_watch import OpticalWatch
from service.health.rig_watch import RigWatch
from service.health.segmentation_watch import SegmentationWatch
from service.processing.background_keeping import KeptBackground
from service.processing.measure_job import WorkerContext, prepare
from service.processing.observers import WatchedResults
from service.processing.process_memory import keep_freed_memory, spare_collections
from service.processing.processing import Processing, ProcessingContext
from service.processing.spool import Spool
from service.processing.worker_pool import WorkerPool
from service.recording.live_recording import recording_source
from service.recording.raw_archive import RawArchive
from service.recording.recordings import open_recordings
from service.results.record import ALGORITHM_VERSION
from service.status import AcquisitionTarget
from service.store import Store, open_store

log = logging.getLogger(__name__)

DRAIN_S = 30.0
"""How long bundles already seen may take after SIGTERM before they are given up."""
DISARM_S = 15.0
"""How long the rig may take to disarm, the last stone's frames included, before it is left alone."""
ARCHIVE_S = 5.0
"""How long frames that wait to be archived may take then; results do not need them."""
ACQUISITION_LIMIT_S = 20.0
"""An armed rig moves twenty times a second; to open or close cameras of which some are dead takes longer."""
COMMIT_LIMIT_S = 30.0
"""A bundle has its outcome so long after its second attempt at the latest."""


async def build(settings: Settings, store: Store) -> Daemon:
    """Put the parts together; nothing runs yet, but what a killed predecessor left behind is settled."""
    configured = await asyncio.to_thread(read_rig, settings.rig.calibration_path)
    devices = await asyncio.to_thread(build_devices, settings.rig.backend_for(configured))
    rig_settings = settings.model_dump(mode="json")["rig"]
    source = recording_source(devices, configured, rig_settings)
    segmentation = await asyncio.to_thread(plan_segmenter, settings.segmentation)
    if segmentation.warning is not None:
        log.error("%s", segmentation.warning)
    pool = WorkerPool(
        slots=settings.workers.slots,
        deadline_s=settings.workers.deadline_s,
        prepare=prepare,
        context=WorkerContext(
            parameters=settings.pipeline,
            is_simulated=devices.is_simulated,
            speed_at_gate_mm_s=source.speed_at_gate_mm_s,
            segmentation=segmentation,
        ),
    )
    verifications = await asyncio.to_thread(
        open_verifications, settings.store.dir / "verifications", settings.verification
    )
    found = await asyncio.to_thread(find_calibrations, settings.store.dir / "calibrations", configured)
    calibrations = Calibrations(found, verifications)
    is_simulated = devices.is_simulated
    camera_ids = tuple(devices.cameras)
    session = await store.begin_session(
        {
            "calibration_id": calibrations.rig.calibration_id,
            "algorithm_version": ALGORITHM_VERSION,
            "is_simulated": is_simulated,
            **settings.rig.describe(),
        }
    )
    if lost := await store.lose_open("crash", "the daemon ended before this bundle was measured"):
        log.error("triggers lost in a crash of the daemon count=%d", lost)
    folder = settings.spool.dir / store.instance_id  # so that daemons with other stores are not disturbed
    await asyncio.to_thread(_make_empty, folder)
    heartbeats = Heartbeats(
        {"acquisition": ACQUISITION_LIMIT_S, "processing": 2 * settings.workers.deadline_s + COMMIT_LIMIT_S}
    )
    spool = Spool(folder, max_bundles=settings.spool.max_bundles, camera_ids=camera_ids)
    enough = 2 * settings.workers.slots  # bundles to keep the workers busy
    archive = RawArchive(store, camera_ids, spool.reuse, max_waiting=enough)
    if settings.store.keep_raw > 0:
        spool.keep = archive.take
    if devices.belt is not None:
        # in fast pace a new bundle comes for each that is through; the archive can take all of them
        devices.belt.permit(min(enough + 1, settings.spool.max_bundles))
        spool.on_release = devices.belt.permit
    recordings = await asyncio.to_thread(
        open_recordings,
        settings.store.dir / "recordings",
        replace(source, rig=calibrations.calibration),
        settings.recordings,
        {"command": "serve", "instance_id": store.instance_id, "session": session},
    )

    fall_height_mm = rig_settings.get("fall_height_mm", 300.0)
    rig_watch = RigWatch(calibrations.calibration, speed_mm_s(fall_height_mm, source.speed_at_gate_mm_s))

    optical_watch = OpticalWatch(configured, settings.optics)
    segmentation_watch = SegmentationWatch(segmentation)

    async def on_activated(calibration: RigCalibration) -> None:
        rig_watch.restart(calibration)
        recordings.use_rig(calibration)
        await store.note_calibration(session, calibration.calibration_id)

    calibrations.on_activated = on_activated

    def on_bundle(bundle: FrameBundle) -> None:
        recordings.offer(bundle)
        spool.offer(bundle)

    rig = Acquisition(
        devices,
        session=session,
        triggers=store,
        bundling=settings.rig.bundling_for(settings.bundling),
        min_cameras=settings.views.min,
        empty_rig=settings.empty_rig,
        is_ball=lambda: devices.belt is None and calibrations.wants_balls,
        on_bundle=on_bundle,
        on_progress=lambda: heartbeats.beat("acquisition", time.monotonic()),
    )
    processing = Processing(
        ProcessingContext(
            session=session,
            camera_ids=camera_ids,
            is_simulated=is_simulated,
            save_silhouettes=settings.store.save_silhouettes,
            folder=folder,
            checked=False,  # this very process has written them into its memory
        ),
        spool=spool,
        pool=pool,
        results=WatchedResults(store, rig_watch, optical_watch, segmentation_watch),
        calibration=calibrations,
        kept=None
        if devices.belt
        else KeptBackground(settings.store.dir, image_sizes_px(configured), rig_settings),
        on_empty=optical_watch.note,
        on_progress=lambda: heartbeats.beat("processing", time.monotonic()),
    )
    return Daemon(
        settings=settings,
        segmentation=segmentation,
        store=store,
        session=session,
        calibrations=calibrations,
        folder=folder,
        pool=pool,
        spool=spool,
        recordings=recordings,
        archive=archive,
        rig=rig,
        processing=processing,
        heartbeats=heartbeats,
        loop_watch=LoopWatch(),
        rig_watch=rig_watch,
        optical_watch=optical_watch,
        segmentation_watch=segmentation_watch,
    )


def _make_empty(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)


async def run(settings: Settings, manager: ServiceManager) -> None:
    """Measure stones until a signal asks to stop.

    Raises
    ------
    ServiceError, DriverError
        A part cannot be started.
    ExceptionGroup
        A part failed beyond what it handles itself.
    """
    keep_freed_memory()
    requests = StopRequests()
    requests.listen()
    async with AsyncExitStack() as ending:
        listener = ending.enter_context(listen(settings.api.host, settings.api.port))
        store = await asyncio.to_thread(open_store, settings.store.dir, keep_raw=settings.store.keep_raw)
        ending.push_async_callback(asyncio.to_thread, store.close)
        daemon = await build(settings, store)
        ending.push_async_callback(asyncio.to_thread, shutil.rmtree, daemon.folder, ignore_errors=True)
        ending.callback(daemon.pool.close)
        ending.push_async_callback(daemon.recordings.close)
        app = create_app(store, daemon, settings.api)
        server = RestServer(server_config(app, settings.api))
        manager.notify("STATUS=warming up the workers")
        # else what is prepared when it is first asked for holds the loop for 0.3 s: FastAPI's routes and their
        # description, and numba's tables, with the first ray from which dark panels are looked for
        await asyncio.gather(
            daemon.pool.start(),
            asyncio.to_thread(app.openapi),
            asyncio.to_thread(daemon.calibrations.calibration.cameras[0].rays, [[0, 0]]),
        )
        spare_collections()
        async with asyncio.TaskGroup() as tasks:
            serving = tasks.create_task(server.serve([listener]))
            tasks.create_task(daemon.spool.write())
            watching_loop = tasks.create_task(daemon.loop_watch.run())
            processing = tasks.create_task(daemon.processing.run())
            archiving = tasks.create_task(daemon.archive.run())
            calibrating = tasks.create_task(daemon.calibrations.run())
            acquiring = tasks.create_task(daemon.rig.run())
            watching = tasks.create_task(feed_watchdog(manager, daemon.watch, daemon.status, requests.stop))
            await server.is_serving.wait()
            log.info("serving url=http://%s:%d", *listener.getsockname()[:2])
            stopping = tasks.create_task(requests.stop.wait())
            if not requests.stop.is_set():
                daemon.rig.request(AcquisitionTarget.ARMED)
                settled = tasks.create_task(daemon.rig.settled.wait())
                await asyncio.wait([settled, stopping], return_when=asyncio.FIRST_COMPLETED)
                settled.cancel()
            if not requests.stop.is_set():
                manager.notify("READY=1")
            renewing = tasks.create_task(daemon.pool.renew())
            await stopping
            renewing.cancel()

            manager.notify("STOPPING=1", "STATUS=disarming")
            daemon.rig.stop()
            await finish(acquiring, requests, DISARM_S)
            if not acquiring.done():
                log.error("the rig does not disarm in time and is left alone")
                daemon.rig.abandon()
                await acquiring
            calibrating.cancel()  # a solution that is under way is asked for again
            daemon.spool.finish()
            await finish(processing, requests, DRAIN_S)
            daemon.processing.abandon()
            await processing
            daemon.pool.close()
            daemon.archive.finish()
            await finish(archiving, requests, ARCHIVE_S)
            archiving.cancel()
            log.info("stopped %s", await store.accounting(daemon.session))
            watching.cancel()
            watching_loop.cancel()
            store.release_waiters()
            server.should_exit = True
            await serving
