"""`stonefall calibrate --method stones`: where the cameras are now, from a recording of any stones."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import typer
from rich.console import Console
from rich.table import Table

from drivers.files.rig_file import write_rig
from drivers.files.times import utc_now
from pipeline.calibration.self_calibration import StoneCalibration, recalibrate
from pipeline.rig.cameras import RigCalibration, rig_to_document
from pipeline.views.epipolar_tangency import ALARM_PX, Outlines
from service.errors import UsageError


def calibrate_from_stones(
    stones: Sequence[Outlines],
    unreadable: Sequence[str],
    initial: RigCalibration,
    out: Path,
    *,
    force: bool,
    as_json: bool,
) -> None:
    """Solve for the cameras that the stones contradict, report, and write the rig.

    Raises
    ------
    CalibrationError
        There are too few stones.
    UsageError
        The cameras still contradict one another, and the rig is not forced.
    """
    created_at = utc_now("seconds")
    found = recalibrate(stones, initial, created_at=created_at, name=out.stem)
    if as_json:
        typer.echo(json.dumps(_document(found, unreadable), indent=2))
    else:
        _print_report(found, unreadable)
    if not (found.is_acceptable or force):
        raise UsageError(
            f"{out} was not written: cameras still contradict one another by {ALARM_PX:g} px or more;"
            " drop the ball (--force writes it nevertheless)"
        )
    out.parent.mkdir(parents=True, exist_ok=True)
    write_rig(out, found.rig)


def _document(found: StoneCalibration, unreadable: Sequence[str]) -> dict[str, object]:
    return {
        "method": "stones",
        "is_acceptable": found.is_acceptable,
        "calibration_id": found.rig.calibration_id,
        "scale": "of the initial rig",
        "stones_fitted": found.n_fitted,
        "stones_judging": found.n_judges,
        "moved": {camera: asdict(movement) for camera, movement in found.moved.items()},
        "tangency_before_px": dict(found.scores_before_px),
        "tangency_after_px": dict(found.scores_after_px),
        "unreadable": list(unreadable),
        "rig": rig_to_document(found.rig),
    }


def _print_report(found: StoneCalibration, unreadable: Sequence[str]) -> None:
    console = Console()
    table = Table("camera", "before px", "after px", "turned °", "shifted mm")
    for camera in found.rig.camera_ids:
        movement = found.moved.get(camera)
        table.add_row(
            camera,
            *(
                f"{scores[camera]:.2f}" if camera in scores else ""
                for scores in (found.scores_before_px, found.scores_after_px)
            ),
            *(("", "") if movement is None else (f"{movement.rotation_deg:.3f}", f"{movement.shift_mm:.3f}")),
        )
    console.print(table)
    for line in (
        *(f"unreadable: {each}" for each in unreadable),
        f"from {found.n_fitted} stones, judged by {found.n_judges} others",
        "scale: not observable; lengths are those of the initial rig",
        f"calibration: {found.rig.calibration_id}",
    ):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
