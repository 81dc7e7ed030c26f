"""Lines follow the plant, and are off when the bridge ends."""

import asyncio
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from support.bridge import overview

from drivers.errors import GateUnavailableError
from drivers.gates.gpio import GpiodOutputs
from pipeline.gradation.specification import Verdict
from service.bridge.contacts import gpio
from service.bridge.contacts.points import Contact
from service.bridge.contacts.settings import GpioSettings
from service.bridge.plant import Plant
from service.bridge.plant_state import PlantState, state_of

SETTINGS = GpioSettings(
    chip="/dev/gpiochip9",
    lines={"17": Contact.RIG_READY, "LAMP": Contact.OUT_OF_LIMITS, "18": Contact.HEARTBEAT},
    active_low=True,
)


class Lines:
    """Lines in memory."""

    def __init__(self) -> None:
        self.on: dict[int | str, bool] = {}
        self.is_closed = False
        self.is_gone = False
        self.switched = asyncio.Event()

    def switch(self, on: Mapping[int | str, bool]) -> None:
        if self.is_gone:
            raise OSError("No such device")
        self.on.update(on)
        self.switched.set()

    def close(self) -> None:
        self.is_closed = True


class ShownPlant(Plant):
    show = Plant._show


@pytest.fixture
def plant(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> ShownPlant:
    monkeypatch.setattr(gpio, "SWITCH_S", 0.001)
    return ShownPlant("http://127.0.0.1:9", None, tmp_path, None)


async def shown(lines: Lines) -> Mapping[int | str, bool]:
    """Return the lines after two more looks: one may be under way."""
    for _ in range(2):
        lines.switched.clear()
        await lines.switched.wait()
    return dict(lines.on)


async def test_lines_follow_the_state_and_end_off(plant: ShownPlant) -> None:
    lines = Lines()
    opened: list[Any] = []
    task = asyncio.create_task(gpio.run(SETTINGS, plant, lambda *given: opened.append(given) or lines))
    assert await shown(lines) == {17: False, "LAMP": False, 18: False}
    assert opened == [("/dev/gpiochip9", {17: True, "LAMP": True, 18: True})]
    well = state_of(overview(), ())
    plant.show(well)
    plant.n_answers = 1
    assert await shown(lines) == {17: True, "LAMP": False, 18: True}
    plant.show(replace(well, verdict=Verdict.DOES_NOT_CONFORM))
    plant.n_answers = 2
    assert await shown(lines) == {17: True, "LAMP": True, 18: False}
    plant.show(PlantState(trouble="no answer"))
    assert await shown(lines) == {17: False, "LAMP": False, 18: False}
    plant.show(well)
    assert (await shown(lines))[17]
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task
    assert lines.on == {17: False, "LAMP": False, 18: False}
    assert lines.is_closed


async def test_a_chip_that_is_gone_ends_the_outlet_with_its_lines_released(plant: ShownPlant) -> None:
    lines = Lines()
    lines.is_gone = True
    with pytest.raises(OSError, match="No such device"):
        await gpio.run(SETTINGS, plant, lambda *_: lines)
    assert lines.is_closed


def test_lines_of_a_chip_are_outputs_and_off_at_first(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}
    values = SimpleNamespace(ACTIVE="active", INACTIVE="inactive")
    request = SimpleNamespace(
        set_values=lambda given: asked.update(values=given), release=lambda: asked.update(closed=1)
    )

    def request_lines(chip: str, **given: Any) -> Any:
        asked.update(chip=chip, **given)
        return request

    line = SimpleNamespace(Value=values, Direction=SimpleNamespace(OUTPUT="output"))
    gpiod = SimpleNamespace(
        line=line, EdgeEvent=1, LineSettings=lambda **given: given, request_lines=request_lines
    )
    monkeypatch.setitem(sys.modules, "gpiod", gpiod)
    lines = GpiodOutputs("/dev/gpiochip9", {17: True})
    assert asked["config"] == {17: {"direction": "output", "output_value": "inactive", "active_low": True}}
    lines.switch({17: True})
    assert asked["values"] == {17: "active"}
    lines.close()
    assert asked["closed"]
    monkeypatch.setitem(sys.modules, "gpiod", SimpleNamespace())  # 1.x, which has other names
    with pytest.raises(GateUnavailableError):
        GpiodOutputs("/dev/gpiochip9", {17: True})
