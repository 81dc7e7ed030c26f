"""Contacts on GPIO lines: lamps and relays that show the state of rig and lot."""

import asyncio
from collections.abc import Callable, Mapping

from drivers.gates.gpio import GpiodOutputs, OutputLines
from service.bridge.contacts.points import BITS, bits
from service.bridge.contacts.settings import GpioSettings
from service.bridge.plant import Plant

SWITCH_S = 0.2
"""Time between two looks at the state."""


async def run(
    settings: GpioSettings,
    plant: Plant,
    open_lines: Callable[[str, Mapping[int | str, bool]], OutputLines] = GpiodOutputs,
) -> None:
    """Switch the lines until it is cancelled; at the end all are off.

    Raises `OSError` or `GateUnavailableError` when the chip or a line cannot be used, or is gone.
    """
    shown = {int(line) if line.isdecimal() else line: contact for line, contact in settings.lines.items()}
    lines = open_lines(settings.chip, dict.fromkeys(shown, settings.active_low))
    try:
        while True:
            on = {
                bit.name: is_on for bit, is_on in zip(BITS, bits(plant.state, plant.n_answers), strict=True)
            }
            lines.switch({line: on[contact] for line, contact in shown.items()})
            await asyncio.sleep(SWITCH_S)
    finally:
        try:
            lines.switch(dict.fromkeys(shown, False))
        finally:
            lines.close()
