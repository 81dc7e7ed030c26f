"""`stonefall calibration`: calibrate and verify the rig of a running daemon, as a client of its REST interface."""

import json
import time
from collections.abc import Container, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from service.base.status import AcquisitionState
from service.calibration.states import OPEN, CalibrationAction, CalibrationState
from service.calibration.verifications import VerificationState
from service.commands.daemon_client import AsJson, DaemonClient, DaemonError
from service.commands.options import with_options

FOLLOW_S, SOLVING_S = 1.0, 0.2

command = typer.Typer(
    no_args_is_help=True,
    help="Calibrate and verify the rig of a running daemon, choose the calibration in use, roll back.",
)

Name = Annotated[str, typer.Argument(metavar="ID", help="Number of the calibration, as `list` shows it.")]
Note = Annotated[str | None, typer.Option(help="Remark; kept with it.")]
Follow = Annotated[bool, typer.Option("--follow", help="Print each drop as it is observed.")]
By = Annotated[str | None, typer.Option(help="Who decides; kept with the calibration.")]


@dataclass(frozen=True, slots=True)
class StartOptions:
    ball_diameters_mm: Annotated[list[float] | None, typer.Option("--ball-diameter-mm")] = None
    """Diameter of the ball, mm; give it twice for balls of two sizes."""
    method: str = "bundle"
    """bundle, paper, or stones (without a ball)."""
    note: Note = None
    by: By = None


@command.command()
@with_options
def start(
    options: StartOptions, follow: Follow = False, *, daemon: DaemonClient, as_json: AsJson = False
) -> None:
    """Open a calibration. Drop the ball through the whole field of view, then `solve`."""
    wanted = {**asdict(options), "ball_diameters_mm": options.ball_diameters_mm or []}
    record = daemon.ask("/calibrations", wanted)
    if as_json and not follow:
        typer.echo(json.dumps(record))
        return
    typer.echo(f"calibration {record['id']}: everything that falls now is observed")
    if (state := daemon.ask("/acquisition")["state"]) != AcquisitionState.ARMED:
        typer.echo(f"but the rig is {state}, and sees nothing that falls: /setup#calibration arms it")
    if follow:
        _follow(daemon, record["id"], as_json)


@command.command()
@with_options
def status(name: Name, follow: Follow = False, *, daemon: DaemonClient, as_json: AsJson = False) -> None:
    """Show a calibration: its drops, their coverage, the residuals before and after."""
    if follow:
        _follow(daemon, name, as_json)
    else:
        _show(daemon.ask(f"/calibrations/{name}"), as_json)


@command.command()
@with_options
def solve(name: Name, by: By = None, *, daemon: DaemonClient, as_json: AsJson = False) -> None:
    """Solve a calibration from the drops so far, and show the result."""
    daemon.ask(f"/calibrations/{name}/solve", {"by": by})
    *_, details = _watched(daemon, f"/calibrations/{name}", (CalibrationState.SOLVING,), SOLVING_S)
    if details["state"] != CalibrationState.SOLVED:
        raise DaemonError(f"calibration {name} is {details['state']}: {details['detail']}")
    _show(details, as_json)


def _decision(action: CalibrationAction, text: str) -> None:
    """Add the command of an action that takes effect at once; `text` is its help."""

    @command.command(action, help=text)
    @with_options
    def decide(name: Name, by: By = None, *, daemon: DaemonClient, as_json: AsJson = False) -> None:
        record = daemon.ask(f"/calibrations/{name}/{action}", {"by": by})
        state = "in use" if record["is_active"] else record["state"]
        typer.echo(json.dumps(record) if as_json else f"calibration {name} is {state}")


_decision(CalibrationAction.ACCEPT, "Make a solution a version that can be activated.")
_decision(CalibrationAction.REJECT, "Close a solved calibration without using it.")
_decision(CalibrationAction.CANCEL, "Close an open calibration in any state.")
_decision(
    CalibrationAction.ACTIVATE,
    "Measure with an accepted calibration from the next stone on. Activate an older one to roll back.",
)


@command.command()
@with_options
def verify(
    diameter_mm: Annotated[float, typer.Option(help="Diameter of the ball, mm.")] = 15.0,
    count: Annotated[int, typer.Option(help="Number of drops to measure.")] = 5,
    note: Note = None,
    by: By = None,
    *,
    daemon: DaemonClient,
    as_json: AsJson = False,
) -> None:
    """Verify the calibration in use with the next balls; exit 1 when it fails."""
    wanted = {"diameter_mm": diameter_mm, "count": count, "note": note, "by": by}
    name = daemon.ask("/verifications", wanted)["id"]
    typer.echo(f"verification {name}: drop the ball {count} times", err=as_json)
    n_shown = 0
    for found in _watched(daemon, f"/verifications/{name}", (VerificationState.COLLECTING,)):
        for ball in found["balls"][n_shown:]:
            measured = ball["detail"] or f"{ball['equivalent_diameter_mm']:.3f} mm"
            typer.echo(f"{ball['bundle']}: {measured}", err=as_json)
        n_shown = len(found["balls"])
    if as_json:
        typer.echo(json.dumps(found))
    if found["state"] != VerificationState.PASSED:
        raise DaemonError(f"verification {name} {found['state']}: {'; '.join(found['problems'])}")
    if not as_json:
        summary = found["summary"]
        difference_mm = summary["vertical_minus_horizontal_mm"]
        typer.echo(
            f"passed: diameter {summary['error_mm']:+.3f} mm off, scatter {summary['sd_mm']:.3f} mm, vertical minus"
            f" horizontal {'unknown' if difference_mm is None else f'{difference_mm:+.3f} mm'}"
        )


@command.command("list")
@with_options
def list_all(daemon: DaemonClient, as_json: AsJson = False) -> None:
    """List all calibrations, newest first."""
    known = daemon.ask("/calibrations")
    if as_json:
        typer.echo(json.dumps(known))
        return
    table = Table("id", "state", "method", "balls mm", "begun", "by", "calibration_id", "remarks")
    for each in known["items"]:
        table.add_row(
            each["id"],
            "in use" if each["is_active"] else each["state"],
            each["method"],
            ", ".join(f"{diameter:g}" for diameter in each["ball_diameters_mm"]),
            each["created_at"],
            each["by"] or "",
            (each["calibration_id"] or "")[:12],
            each["detail"] or each["note"] or "",
        )
    Console().print(table)


def _follow(daemon: DaemonClient, name: str, as_json: bool) -> None:
    """Print each drop as it is observed, until the calibration is accepted, rejected or cancelled."""
    n_shown = 0
    for details in _watched(daemon, f"/calibrations/{name}", OPEN):
        for number, ball in enumerate(details["drops"][n_shown:], start=n_shown + 1):
            typer.echo(json.dumps(ball) if as_json else _line(number, ball, details))
            n_shown = number
    if not as_json:
        _show(details)


def _watched(
    daemon: DaemonClient, path: str, states: Container[str], pause_s: float = FOLLOW_S
) -> Iterator[dict[str, Any]]:
    """Yield the document at a path again and again while it is in these states, and once after them."""
    while (found := daemon.ask(path))["state"] in states:
        yield found
        time.sleep(pause_s)
    yield found


def _line(number: int, ball: Mapping[str, Any], details: Mapping[str, Any]) -> str:
    where = "not located"
    if ball["center_mm"] is not None:
        where = f"at {', '.join(f'{each:+.1f}' for each in ball['center_mm'])} mm"
    worst_px = max(ball["residuals_px"].values(), default=0.0)
    coverage = details["coverage"]
    return f"ball {number:3d}: {len(ball['views'])} views, {where}, residual up to {worst_px:.2f} px; " + (
        ball["problem"] or f"still missing: {coverage['missing'] or 'nothing: solve it'}"
    )


def _show(details: Mapping[str, Any], as_json: bool = False) -> None:
    if as_json:
        typer.echo(json.dumps(details))
        return
    coverage, report = details["coverage"], details["report"]
    typer.echo(
        f"calibration {details['id']}: {'in use' if details['is_active'] else details['state']},"
        f" {details['method']}, {len(details['drops'])} drops"
    )
    if details["detail"]:
        typer.echo(f"  {details['detail']}")
    extent = " x ".join(f"{each:.1f}" for each in coverage["extent_mm"])
    typer.echo(f"  balls within {extent} mm; missing: {coverage['missing'] or 'nothing'}")
    if report is not None:
        sd = (report["uncertainty"] or {}).get("length_sd_percent")
        lens = ""
        if lenses := report.get("lenses"):  # older reports have none
            focus_mm = [found["value"] for found in lenses["focus_mm"].values()]
            where = f" focused at {min(focus_mm):.1f} to {max(focus_mm):.1f} mm" if focus_mm else ""
            lens = f", lenses F{lenses['f_number']['value']:.2f}{where}"
        typer.echo(
            f"  scale {report['scale']}, held out {_px(report['held_out_px'])} px,"
            f" length {'unknown' if sd is None else f'+-{sd:.4f} %'}, {len(report['drops_used'])} drops used{lens}"
        )
        for problem in report["problems"]:
            typer.echo(f"  {problem['camera'] or 'rig'}: {problem['detail']}")
    after = {} if report is None else report["residuals_after_px"]
    table = Table("camera", "balls", "of the image %", "residual before px", "after px")
    for camera, seen in coverage["cameras"].items():
        table.add_row(
            camera,
            str(seen["n_drops"]),
            f"{100 * seen['field_share']:.0f}",
            _px(details["residuals_before_px"].get(camera)),
            _px(after.get(camera)),
        )
    Console().print(table)


def _px(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"
