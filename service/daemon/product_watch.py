"""Watch what is produced: verdict and drift of its lots, the verdict of the open one, and that stones fall."""

import asyncio
import logging
import sqlite3
import time
from contextlib import suppress
from dataclasses import dataclass

from drivers.files.times import utc_now
from pipeline.gradation.specification import Verdict
from service.base.errors import ServiceError
from service.base.messages import Code, about, joined, message
from service.base.status import AcquisitionState, AcquisitionStatus, Checks, HealthCheck, trouble_check
from service.daemon.overview.overviews import KeptFigures
from service.lots.lots import reach_verdict
from service.lots.outcome import ReachedVerdict
from service.lots.shifts import LotsSettings
from service.lots.trends.control import CONFORMITY, DRIFT, FEED, product_drift
from service.lots.yardsticks import Request
from service.store import Store
from service.web.control import Control

log = logging.getLogger(__name__)

LOOK_S = 5.0
"""Time between two looks at the open lot; figures of large ones are made less often."""
AGAIN_S = 60.0
"""Time after which the standing is read again although nothing has happened: limits may have been set."""
DECIDED = (Verdict.CONFORMS, Verdict.DOES_NOT_CONFORM)


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """State of what is produced: the product of the open lot, else of the one that was closed last."""

    open_lot: str | None = None
    conformity: str | None = None  # the newest lot with a verdict does not conform
    drift: str | None = None


class ProductWatch:
    """Watches the product: `run` is its task. Call it on the event loop."""

    def __init__(self, store: Store, control: Control) -> None:
        self._store = store
        self._control = control
        self._standing = Standing()
        self._last_event, self._read_s = -1, 0.0
        self._fed_s = time.monotonic()
        self._told: tuple[str, Verdict | None] | None = None

    def checks(self) -> Checks:
        """Return the checks of the product; `feed` is to be asked for often."""
        return {
            CONFORMITY: trouble_check(self._standing.conformity),
            DRIFT: trouble_check(self._standing.drift),
            FEED: self._feed(time.monotonic()),
        }

    async def run(self) -> None:
        """Look whenever something has happened, and at the open lot as its stones come, until the store is released."""
        while not self._store.is_released:
            last_event = self._store.last_event
            try:
                await self.look()
            except ServiceError as err:  # the store is held, or a specification is gone
                log.warning("the product is not watched: %s", err)
            with suppress(TimeoutError):
                async with asyncio.timeout(LOOK_S):
                    await self._store.wait_for_event(last_event)

    async def look(self) -> None:
        """Look once."""
        last_event, now_s = self._store.last_event, time.monotonic()
        if last_event != self._last_event or now_s - self._read_s > AGAIN_S:
            self._standing = await self._store.read(standing)
            self._last_event, self._read_s = last_event, now_s
        if (lot := self._standing.open_lot) is None:
            return
        request = Request(measured=self._control.part(LotsSettings).measured)
        figures = await self._control.part(KeptFigures).with_new_results(lot, request)
        if figures is None or (lot, figures.verdict) == self._told:
            return
        if figures.verdict in DECIDED:
            said = {name: getattr(figures, name) for name in ("verdict", "is_partial", "measured")}
            await self._store.write(reach_verdict, lot, ReachedVerdict(**said, at=utc_now()))
            self._told = lot, figures.verdict

    def _feed(self, now_s: float) -> HealthCheck:
        """Warn when no stone has fallen for a time: an armed rig with an open lot counts as a feeder that runs."""
        limit_min = self._control.part(LotsSettings).no_stones_min
        rig = self._control.part(AcquisitionStatus)
        if rig.state is not AcquisitionState.ARMED or self._standing.open_lot is None or limit_min is None:
            self._fed_s = now_s
        elif rig.last_stone_age_s is not None:
            self._fed_s = max(self._fed_s, now_s - rig.last_stone_age_s)
        quiet_min = (now_s - self._fed_s) / 60
        if limit_min is None or quiet_min <= limit_min:
            return trouble_check(None)
        detail = message(Code.NO_STONES, quiet_min=quiet_min, lot=str(self._standing.open_lot))
        return trouble_check(detail, round(quiet_min, 1), "min")


def standing(connection: sqlite3.Connection) -> Standing:
    """Return the state of what is produced."""
    newest = connection.execute(
        "SELECT lot, product, state FROM lots WHERE state <> 'void'"
        " ORDER BY state = 'open' DESC, closed_at DESC LIMIT 1"
    ).fetchone()
    if newest is None:
        return Standing()
    lot, product, state = newest
    return Standing(
        open_lot=lot if state == "open" else None,
        conformity=_conformity(connection, product),
        drift=_drift(connection, product),
    )


def _conformity(connection: sqlite3.Connection, product: str) -> str | None:
    """Return that the newest lot of a product with a verdict does not conform, None when it does."""
    found = connection.execute(
        "SELECT lot, state, verdict FROM (SELECT lot, state, opened_at,"
        " coalesce(completion ->> 'verdict', reached ->> 'verdict') AS verdict FROM lots"
        " WHERE product = ? AND state <> 'void') WHERE verdict IN (?, ?) ORDER BY opened_at DESC, lot DESC LIMIT 1",
        (product, *DECIDED),
    ).fetchone()
    if found is None or found[2] != Verdict.DOES_NOT_CONFORM:
        return None
    is_open = found[1] == "open"
    code = Code.LOT_DOES_NOT_CONFORM_SO_FAR if is_open else Code.LOT_DOES_NOT_CONFORM
    return message(code, lot=found[0], product=product)


def _drift(connection: sqlite3.Connection, product: str) -> str | None:
    if (found := product_drift(connection, product)) is None:
        return None
    figures = [
        message(
            Code.FIGURE_DRIFTS,
            figure=each.figure,
            value=float(f"{each.value:.4g}"),
            centre=float(f"{each.centre:.4g}"),
            rules=", ".join(each.rules),
        )
        for each in found.figures
    ]
    return (told := joined(figures)) and about(product, told)
