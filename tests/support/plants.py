"""A plant whose states and results a test sets, in the place of a daemon, for the outlets of the bridge."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from service.bridge.plant import Plant
from service.bridge.plant_state import PlantState
from service.bridge.reference_client import Gap, Position, Step, keep_position, kept_position

ANSWERS = PlantState(
    daemon_answers=True,
    trouble=None,
    at="2026-08-15T10:00:00Z",
    instance_id="one",
    ready=True,
    is_simulated=True,
)


def result(seq: int, **more: Any) -> dict[str, Any]:
    """Return a lean result."""
    return {
        "seq": seq, "id": f"one-{seq:08d}", "revision": 1, "kind": "particle", "outcome": "measured",
        "captured_at": "2026-08-15T09:59:00Z", "recorded_at": "2026-08-15T09:59:01Z",
        "sieve_size_mm": 11.5, "mass_g": None, "is_simulated": True, "is_replay": False, **more,
    }  # fmt: skip


class FakePlant(Plant):
    """States and results that a test gives; the cursor is in the file that the outlets keep it in."""

    def __init__(self, folder: Path, state: PlantState = ANSWERS) -> None:
        super().__init__("http://127.0.0.1:1", None, folder, None)
        self.page = 1000
        self._results: list[dict[str, Any]] = []
        self.gap: Gap | None = None
        self.show(state)

    def show(self, state: PlantState) -> None:
        """Have another state."""
        self._show(state)

    def fall(self, *results: dict[str, Any]) -> None:
        """Have more results."""
        self._results += results

    async def results(self, outlet: str, fields: str | None = "lean") -> AsyncIterator[Step]:
        file = self.folder / outlet / "results.cursor"
        file.parent.mkdir(parents=True, exist_ok=True)
        while True:
            after = kept_position(file).after
            items = [each for each in self._results if each["seq"] > after][: self.page]
            if items or self.gap:
                position = Position("one", items[-1]["seq"] if items else after)
                yield Step(position, tuple(items), self.gap)
                self.gap = None
                keep_position(file, position)
            else:
                await asyncio.sleep(0.005)
