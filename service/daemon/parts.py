"""All parts of the daemon, in one list, and how those end that must not just be cancelled."""

import asyncio
import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from service.acquisition.acquisition import Acquisition
from service.base.systemd import use_level
from service.daemon.alarming import Alarming
from service.daemon.backing_up import BackingUp
from service.daemon.part import Part, Running
from service.daemon.product_watch import ProductWatch
from service.daemon.running_daemon import Daemon
from service.daemon.session import lose_all_crashed
from service.daemon.shift_sheets import ShiftWatch, letter_writer
from service.daemon.stopping import StopRequests
from service.delivery.file_drop import FileDrop, MakeFiles
from service.delivery.mail import Mail
from service.recording.raw_archive import RawArchive
from service.store import Store
from service.store.checks import store_checks
from service.store.event_log import EventLog
from service.web.control import Control
from service.web.reader_process import Reading

log = logging.getLogger(__name__)

DRAIN_S = 30.0
"""Longest wait for the results of bundles already seen, after which they are lost, reason `shutdown`."""
DISARM_S = 15.0
"""Longest wait for the rig to disarm, the last stone's frames included, before its devices are abandoned."""
HELD_S = 2.0
"""Last wait for a store that is held; triggers without an outcome then are lost, reason `crash`, at the next start."""
ARCHIVE_S = 5.0
"""Longest wait for frames that are still to be archived, which no result needs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Deliveries:
    """What writes files into folders, each with what makes them, and what sends mail."""

    drops: Sequence[tuple[FileDrop, Callable[[Store, Control, Reading], MakeFiles]]]
    mail: Mail


def parts_of(daemon: Daemon, deliveries: Deliveries, reading: Reading, requests: StopRequests) -> list[Part]:
    """Return the parts in the order in which they start; they end in reverse order.

    What keeps and delivers results ends after what makes them, which ends after the rig: a stop loses nothing that it
    has time for. What is cancelled half-way (a backup, a removal, a delivery, a calibration that is being solved) is
    made up for by the next start, or asked for again.
    """
    session, watches, calibrations = daemon.session, daemon.watches, daemon.calibrations
    store, archive, retaining = session.store, daemon.archive, daemon.retaining
    processing, acquisition = daemon.processing, daemon.acquisition
    alarming = Alarming(daemon.alarms, session.events)
    backing_up = BackingUp(store, session.settings.store)
    watch = ProductWatch(store, daemon)
    shifts = ShiftWatch(store, daemon)
    write = letter_writer(store, daemon, reading)
    return [
        Part(run=watches.loop.run, checks=watches.loop.checks),
        Part(run=partial(alarming.run, daemon.health), close=partial(_end_alarming, session.events)),
        Part(run=archive.run, close=partial(_end_archive, archive, requests), checks=archive.checks),
        Part(run=backing_up.run, checks=backing_up.checks, use=lambda new: backing_up.use(new.store)),
        Part(run=retaining.run, checks=retaining.checks, use=lambda new: retaining.use(new.store.retention)),
        Part(run=daemon.webhooks.run, checks=daemon.webhooks.checks),
        *(
            Part(run=partial(drop.run, maker(store, daemon, reading)), checks=drop.checks)
            for drop, maker in deliveries.drops
        ),
        Part(run=partial(deliveries.mail.run, write), checks=deliveries.mail.checks),
        Part(run=shifts.run),
        Part(run=watch.run, checks=watch.checks),
        Part(
            run=partial(lose_all_crashed, store, session.left),
            checks=lambda: store_checks(store, daemon.spool.n_waiting),
        ),
        Part(run=daemon.spool.write, close=lambda running: running, checks=daemon.spool.checks),
        Part(run=processing.run, close=partial(_end_processing, daemon, requests), checks=daemon.pool.checks),
        Part(
            run=calibrations.run,
            checks=calibrations.checks,
            use=lambda new: calibrations.verifications.use(new.verification),
        ),
        Part(
            run=acquisition.run,
            close=partial(_end_acquisition, acquisition, requests),
            checks=acquisition.checks,
        ),
        Part(checks=lambda: {"progress": watches.progress.check(time.monotonic())}),
        Part(checks=lambda: watches.segmentation.checks(has_background=processing.background is not None)),
        Part(checks=watches.rig.checks),
        Part(checks=watches.optics.checks, use=lambda new: watches.optics.use(new.optics)),
        Part(checks=watches.refinement.checks),
        Part(checks=session.quarantine.checks),
        Part(checks=daemon.recordings.checks),
        Part(checks=daemon.keys.checks, use=lambda new: daemon.keys.use(new.api.keys)),
        Part(checks=daemon.configured.checks, use=lambda new: use_level(new.log.level)),
    ]


async def _end_alarming(events: EventLog, running: Running) -> None:
    """Write the events of the stop."""
    running.cancel()
    await events.written(HELD_S)


async def _end_archive(archive: RawArchive, requests: StopRequests, running: Running) -> None:
    archive.finish()
    await requests.wait_for(running, ARCHIVE_S)


async def _end_processing(daemon: Daemon, requests: StopRequests, running: Running) -> None:
    """Measure the bundles of the spool; those without a result in time are lost, reason `shutdown`."""
    daemon.remeasuring.close()
    daemon.spool.finish()
    await requests.wait_for(running, DRAIN_S)
    daemon.processing.abandon()
    while not running.done():
        await asyncio.wait([running], timeout=HELD_S)
        if (trouble := daemon.session.store.trouble) is not None:
            log.error("outcomes are given up bundles=%d: %s", daemon.spool.n_waiting, trouble)
            running.cancel()
    daemon.pool.close()


async def _end_acquisition(acquisition: Acquisition, requests: StopRequests, running: Running) -> None:
    """Disarm the rig and hand over what it has seen."""
    acquisition.stop()
    await requests.wait_for(running, DISARM_S)
    if not running.done():
        log.error("the rig did not disarm in time: its devices are abandoned")
        acquisition.abandon()
        await running
