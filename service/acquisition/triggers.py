"""Triggers get a unique name and become durable before their bundles are handed over."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

from pipeline.frames import BundleKind, GateCount, Trigger
from service.base.messages import CodedText, about


class TriggerLog(Protocol):
    """Durable record of the triggers; the store is one. It never keeps the loop waiting for a disk."""

    async def record_triggers(
        self, session: int, triggers: Mapping[str, Trigger], gate_count: GateCount | None
    ) -> None:
        """Record triggers, and the gate's count at the last if everything counted before it is recorded."""

    async def forget_gate_count(self, session: int) -> None:
        """Record that the gate was disarmed: what it counts from now on is not missed."""

    @property
    def trouble(self) -> object | None:
        """Why nothing can be recorded now, a message as text; None when it can."""


class Triggers:
    """The triggers of a session; without a log they need no outcome, as those of a test pulse."""

    def __init__(self, log: TriggerLog | None, session: int, is_ball: Callable[[], bool]) -> None:
        """While `is_ball` returns True, triggers are of calibration balls instead of stones."""
        self._log = log
        self._session = session
        self._is_ball = is_ball
        self._n_named = 0
        self.last_s = time.monotonic()
        self.last_stone_s: float | None = None

    @property
    def trouble(self) -> CodedText | None:
        """Why they cannot be recorded now, None when they can."""
        trouble = None if self._log is None else self._log.trouble
        return None if trouble is None else about("store", str(trouble))

    async def record(self, triggers: Sequence[Trigger], gate_count: GateCount | None = None) -> list[Trigger]:
        """Make triggers durable in one transaction, and return them with their names."""
        named = {str(trigger.name): trigger for trigger in map(self._with_name, triggers)}
        if named and self._log is not None:
            await self._log.record_triggers(self._session, named, gate_count)
        return list(named.values())

    async def forget_gate_count(self) -> None:
        if self._log is not None:
            await self._log.forget_gate_count(self._session)

    def _with_name(self, trigger: Trigger) -> Trigger:
        """Return the trigger with a unique name, which its sequence number is not: a gate may count anew."""
        self.last_s = time.monotonic()
        if trigger.kind is not BundleKind.BACKGROUND:
            self.last_stone_s = self.last_s
            if self._is_ball():
                trigger = replace(trigger, kind=BundleKind.BALL)
        if trigger.name is not None:
            return trigger
        self._n_named += 1
        suffix = "" if trigger.is_announced else "-orphan"
        return replace(trigger, name=f"{self._n_named:08d}{suffix}")
