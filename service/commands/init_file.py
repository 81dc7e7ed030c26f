"""The configuration file that `stonefall init` writes: what a site must say, each with a comment."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from service.configuration.rig_settings import CameraPlace

MISSING = "MISSING"


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """What is known of a site; what is None is missing."""

    interfaces: tuple[str, ...]
    cameras: Mapping[str, CameraPlace]  # by place; those that are missing are absent
    places: tuple[str, ...]
    gate: str | None
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
            f"is_simulated = {json.dumps(answers.is_simulated)}  # true: results are marked as synthetic",
            f"calibration = {_text(answers.calibration)}  # rig file; the design until the rig is calibrated",
            f"interfaces = {json.dumps(answers.interfaces)}  # this machine's addresses towards the cameras; []: all",
            "",
            *_gate(answers.gate),
            "",
            "# Which camera is in which place; /setup#places tells them apart by their lamps.",
            *(line for place in answers.places for line in _camera(place, answers.cameras.get(place))),
            "[spool]",
            f"dir = {_text(answers.spool)}  # on tmpfs",
            "",
            "[store]",
            f"dir = {_text(answers.store)}  # results, meshes, silhouettes, recordings",
            "",
            "[measuring]",
            "# density_g_cm3 = 2.70  # particle density (EN 1097-6); without it no mass is reported"
            if answers.density_g_cm3 is None
            else f"density_g_cm3 = {answers.density_g_cm3}  # particle density (EN 1097-6)",
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
        f"port = {json.dumps(port)}  # a name that stays when the gate is plugged in elsewhere",
    ]


def _camera(place: str, camera: CameraPlace | None) -> Sequence[str]:
    if camera is None:
        return [
            f"# {MISSING}: camera {place}",
            "# [[rig.cameras]]",
            f"# id = {json.dumps(place)}",
            '# serial = "..."',
            "",
        ]
    named = {"id": place, "serial": camera.serial, "address": camera.address, "user_name": camera.user_name}
    lines = [f"{name} = {json.dumps(value)}" for name, value in named.items() if value is not None]
    return ["[[rig.cameras]]", *lines, ""]


def _text(path: Path) -> str:
    return json.dumps(str(path))
