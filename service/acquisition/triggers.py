"""In the place of the store: triggers that need no outcome, of a recording or a test pulse."""

from collections.abc import Mapping

from pipeline.frames import GateCount, Trigger


class NoAccounting:
    """A `TriggerLog` that keeps nothing."""

    trouble = None

    async def record_triggers(
        self, session: int, triggers: Mapping[str, Trigger], gate_count: GateCount | None
    ) -> None:
        pass

    async def forget_gate_count(self, session: int) -> None:
        pass
