"""The composition root: builds the parts, runs them in one task group, ends them in order.

The first SIGTERM or SIGINT stops the rig, measures what it has seen and exits 0; the second one gives up
what is not measured yet. Whatever a part cannot handle ends the group, and with it the process.
"""

import asyncio
import logging
import shutil
import signal
import time
from contextlib import AsyncExitStack
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from drivers.factory import build_devices
from drivers.rig_file import read_rig
from pipeline.fall import speed_mm_s
from pipeline.frames import CameraId, FrameBundle
from pipeline.rig import RigCalibration
from service.acquisition import Acquisition
from service.api.app import create_app
from service.api.server import server_config
from service.calibration_start import find_calibrations
from service.calibrations import Calibrations, image_sizes_px
from service.control import AcquisitionState, AcquisitionStatus, AcquisitionTarget, CameraStatus, Health
from service.health import Facts, assess
from service.kept_background import KeptBackground
from service.loop_watch import LoopWatch
from service.processing import Processing, ProcessingContext
from service.record import ALGORITHM_VERSION
from service.recording_live import recording_source
from service.recordings import Recordings, open_recordings
from service.rest_server import RestServer, listen
from service.rig_watch import CameraScore, RigWatch, WatchedResults
from service.settings import Settings
from service.spool import Spool
from service.store import Store, open_store
from service.supervision import Heartbeats
from service.systemd import ServiceManager, feed_watchdog
from service.verifications import open_verifications
from service.worker_job import WorkerContext, initialize
from service.workers import WorkerPool

log = logging.getLogger(__name__)

DRAIN_S = 30.0
"""How long bundles already seen may take after SIGTERM before they are given up."""
DISARM_S = 15.0
"""How long the rig may take to disarm, the last stone's frames included, before it is left alone."""
ACQUISITION_LIMIT_S = 20.0
"""An armed rig moves twenty times a second; to open or close cameras of which some are dead takes longer."""
COMMIT_LIMIT_S = 30.0
"""A bundle has its outcome so long after its second attempt at the latest."""


@dataclass(slots=True)
class StopRequests:
    """What the signals have asked for."""

    stop: asyncio.Event = field(default_factory=asyncio.Event)
    hurry: asyncio.Event = field(default_factory=asyncio.Event)

    def listen(self) -> None:
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self._on_stop, number)
        loop.add_signal_handler(
            signal.SIGHUP, log.warning, "SIGHUP ignored: a new configuration needs a restart"
        )

    def _on_stop(self, number: signal.Signals) -> None:
        log.info("stop requested signal=%s", number.name)
        if self.stop.is_set():
            self.hurry.set()
        self.stop.set()


@dataclass(frozen=True, slots=True, kw_only=True)
class Daemon:
    """The parts at work; to the REST interface they are its `Control`."""

    settings: Settings
    store: Store
    session: int
    calibrations: Calibrations
    folder: Path  # on tmpfs, for bundles and for the workers' files
    pool: WorkerPool
    spool: Spool
    recordings: Recordings
    rig: Acquisition
    processing: Processing
    heartbeats: Heartbeats
    loop_watch: LoopWatch
    rig_watch: RigWatch

    def acquisition(self) -> AcquisitionStatus:
        return self.rig.status()

    async def set_acquisition(self, target: AcquisitionTarget) -> AcquisitionState:
        state = self.rig.request(target)
        log.info("acquisition requested target=%s state=%s", target, state)
        return state

    def cameras(self) -> list[CameraStatus]:
        scores = self.rig_watch.scores()
        return [
            replace(status, **asdict(scores.get(status.id, CameraScore())))
            for status in self.rig.cameras.statuses()
        ]

    async def snapshot(self, camera: CameraId) -> bytes | None:
        return await self.rig.cameras.snapshot(camera)

    def health(self) -> Health:
        return assess(
            Facts(
                acquisition=self.rig.status(),
                blind_triggers=self.rig.cameras.blind_triggers,
                cameras=self.cameras(),
                views=self.settings.views,
                waiting=self.spool.held,
                max_waiting=self.spool.max_bundles,
                overflows=self.spool.overflows,
                workers=len(self.pool.pids),
                slots=self.pool.size,
                worker_restarts=self.pool.restarts,
                loop_ms=self.loop_watch.worst_ms(),
                clock_step_s=self.loop_watch.clock_step_s(),
                late=self.late(),
                has_background=self.processing.has_background,
                calibration=self.calibrations.facts(),
                last_seq=self.store.last_seq,
                free_bytes=shutil.disk_usage(self.settings.store.dir).free,
                recording_trouble=self.recordings.trouble,
                suspicions=self.rig_watch.suspicions(),
            )
        )

    def late(self) -> list[str]:
        """Parts that have something to do and make no progress."""
        return self.heartbeats.late(time.monotonic())

    def watch(self) -> list[str]:
        """Look after the parts, often: those with nothing to do are not late, the others are named."""
        if not self.rig.is_at_work:
            self.heartbeats.beat("acquisition", time.monotonic())
        if self.spool.held == 0:
            self.heartbeats.beat("processing", time.monotonic())
        return self.late()

    def status(self) -> str:
        """One line for `systemctl status`."""
        return f"{self.rig.state}, {self.spool.held} bundles waiting, last result {self.store.last_seq}"


async def build(settings: Settings, store: Store) -> Daemon:
    """Put the parts together; nothing runs yet, but what a killed predecessor left behind is settled."""
    configured = await asyncio.to_thread(read_rig, settings.rig.calibration_path)
    devices = await asyncio.to_thread(build_devices, settings.rig.backend_for(configured))
    rig_settings = settings.model_dump(mode="json")["rig"]
    source = recording_source(devices, configured, rig_settings)
    pool = WorkerPool(
        slots=settings.workers.slots,
        deadline_s=settings.workers.deadline_s,
        initialize=initialize,
        context=WorkerContext(
            parameters=settings.pipeline,
            is_simulated=devices.is_simulated,
            speed_at_gate_mm_s=source.speed_at_gate_mm_s,
        ),
    )
    verifications = await asyncio.to_thread(
        open_verifications, settings.store.dir / "verifications", settings.verification
    )
    found = await asyncio.to_thread(find_calibrations, settings.store.dir / "calibrations", configured)
    calibrations = Calibrations(found, pool, verifications)
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
    if devices.belt is not None:
        # in fast pace a new bundle comes for each that is through: enough to keep the workers busy
        devices.belt.permit(min(2 * settings.workers.slots + 1, settings.spool.max_bundles))
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
            archive_raw=settings.store.keep_raw > 0,
            save_silhouettes=settings.store.save_silhouettes,
            folder=folder,
        ),
        spool=spool,
        pool=pool,
        results=WatchedResults(store, rig_watch),
        calibration=calibrations,
        kept=None
        if devices.belt
        else KeptBackground(settings.store.dir, image_sizes_px(configured), rig_settings),
        on_progress=lambda: heartbeats.beat("processing", time.monotonic()),
    )
    return Daemon(
        settings=settings,
        store=store,
        session=session,
        calibrations=calibrations,
        folder=folder,
        pool=pool,
        spool=spool,
        recordings=recordings,
        rig=rig,
        processing=processing,
        heartbeats=heartbeats,
        loop_watch=LoopWatch(),
        rig_watch=rig_watch,
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
        server = RestServer(server_config(create_app(store, daemon, settings.api), settings.api))
        manager.notify("STATUS=warming up the workers")
        await daemon.pool.start()
        async with asyncio.TaskGroup() as tasks:
            serving = tasks.create_task(server.serve([listener]))
            tasks.create_task(daemon.spool.write())
            watching_loop = tasks.create_task(daemon.loop_watch.run())
            processing = tasks.create_task(daemon.processing.run())
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
            await stopping

            manager.notify("STOPPING=1", "STATUS=disarming")
            daemon.rig.stop()
            await finish(acquiring, requests, DISARM_S)
            if not acquiring.done():
                log.error("the rig does not disarm in time and is left alone")
                daemon.rig.abandon()
                await acquiring
            daemon.spool.finish()
            await finish(processing, requests, DRAIN_S)
            daemon.processing.abandon()
            await processing
            daemon.pool.close()
            log.info("stopped %s", await store.accounting(daemon.session))
            calibrating.cancel()
            watching.cancel()
            watching_loop.cancel()
            store.release_waiters()
            server.should_exit = True
            await serving


async def finish(part: "asyncio.Task[None]", requests: StopRequests, limit_s: float) -> None:
    """Wait until the part is through, somebody is in a hurry, or it takes too long."""
    hurry = asyncio.create_task(requests.hurry.wait())
    await asyncio.wait([part, hurry], timeout=limit_s, return_when=asyncio.FIRST_COMPLETED)
    hurry.cancel()
