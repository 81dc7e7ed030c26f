"""The configuration file that `stonefall init` writes: what a site must say, each with a comment."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from service.configuration.rig_settings import CameraPlace

MISSING = "MISSING"


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """Facts about a site; None: missing."""

    interfaces: tuple[str, ...]
    cameras: Mapping[str, CameraPlace]  # by place; those that are missing are absent
    places: tuple[str, ...]
    gate: str | None
    strobe_line: str | None  # None: the light is not fired by the cameras
    flash_us: float | None
    calibration: Path
    spool: Path
    store: Path
    density_g_cm3: float | None
    is_simulated: bool


def configuration_text(answers: Answers) -> str:
    """Return the file; what is missing is a comment with the word MISSING in it."""
    return "\n".join(
        [
            "# Configuration of the daemon, written by stonefall init; after a change: stonefall check-config FILE.",
            "# Everything else has its default; check-config prints all settings, deploy/stonefall.toml explains them.",
            "",
            "[rig]",
            'backend = "aravis"',
            _line("is_simulated", answers.is_simulated, "true: results are marked as synthetic"),
            _line(
                "calibration", str(answers.calibration), "rig file; the design until the rig is calibrated"
            ),
            _line("interfaces", answers.interfaces, "this machine's addresses towards the cameras; []: all"),
            _line_or_example(
                "strobe_line",
                answers.strobe_line,
                "Line2",
                "output of the cameras that fires the light panels; not set: they are always on",
            ),
            _line_or_example(
                "flash_us", answers.flash_us, 15.0, "light of one flash, if shorter than the exposure"
            ),
            "",
            *_gate(answers.gate),
            "",
            "# Which camera is in which place; /setup#places tells them apart by their lamps.",
            *(line for place in answers.places for line in _camera(place, answers.cameras.get(place))),
            "[spool]",
            _line("dir", str(answers.spool), "on tmpfs"),
            "",
            "[store]",
            _line("dir", str(answers.store), "results, meshes, silhouettes, recordings"),
            "",
            "[measuring]",
            _line_or_example(
                "density_g_cm3",
                answers.density_g_cm3,
                2.7,
                "particle density (EN 1097-6); without it no mass is reported",
            ),
            "",
        ]
    )


def _gate(port: str | None) -> Sequence[str]:
    if port is None:
        return [
            f"# {MISSING}: the light gate; ls /dev/serial/by-id shows names of ports; other kinds: drivers/README.md",
            "# [rig.gate.serial]",
            '# port = "/dev/serial/by-id/..."',
        ]
    return [
        "[rig.gate.serial]",
        _line("port", port, "a name that stays when the gate is plugged in elsewhere"),
    ]


def _camera(place: str, camera: CameraPlace | None) -> Sequence[str]:
    if camera is None:
        return [
            f"# {MISSING}: camera {place}",
            "# [[rig.cameras]]",
            f'# id = "{place}"',
            '# serial = "..."',
            "",
        ]
    named = {"id": place, "serial": camera.serial, "address": camera.address, "user_name": camera.user_name}
    return [
        "[[rig.cameras]]",
        tomli_w.dumps({name: value for name, value in named.items() if value is not None}),
    ]


def _line_or_example(name: str, value: Any, example: Any, comment: str) -> str:
    return f"# {_line(name, example, comment)}" if value is None else _line(name, value, comment)


def _line(name: str, value: Any, comment: str) -> str:
    return f"{tomli_w.dumps({name: value}).rstrip()}  # {comment}"
