"""`stonefall record`: record bundles of images without the daemon.

Devices, acquisition and recorder are those of the daemon; nothing is measured.
"""

import asyncio
import json
import signal
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from drivers.factory import build_devices
from drivers.files.durable import require_unused
from drivers.files.recording import RecordingWriter
from drivers.files.rig_file import read_rig
from service.acquisition.acquisition import INBOX_TRIGGERS, Acquisition, AcquisitionParameters
from service.base.errors import ServiceError, SettingsError
from service.base.status import AcquisitionState, AcquisitionTarget
from service.commands.options import Config
from service.configuration.settings import Settings, load_settings, problems
from service.recording.live_recording import EndedBy, LiveRecording
from service.recording.recordings import require_room
from service.store.schema import is_locked

POLL_S = 0.1
"""Interval at which progress is shown and the end is looked for."""


def command(
    out: Annotated[Path, typer.Argument(help="Folder of the new recording.")],
    config: Config,
    count: Annotated[
        int | None, typer.Option(min=1, help="Number of stones to record; default: until Ctrl-C.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Record from the rig of a configuration until Ctrl-C, which keeps what was recorded.

    A second Ctrl-C does not wait for devices that do not answer.
    """
    settings = load_settings(config)
    if wrong := "; ".join(problems(settings)):
        raise SettingsError(f"{config}: {wrong}")
    require_unused(out)
    recording = asyncio.run(_record(settings, out.resolve(), count))
    status = recording.status()
    if status.reason is not None:
        raise ServiceError(f"{out}: {status.reason}")
    summary = {
        "recording": str(out),
        "bundles": status.bundles,
        "stones": recording.stones,
        "without_frames": recording.without_frames,
        "bytes": status.bytes,
        "ended_by": status.ended_by,
    }
    typer.echo(
        json.dumps(summary)
        if as_json
        else f"{out}: {recording.stones} stones, {status.bundles - recording.stones} exposures of the empty rig,"
        f" {status.bytes / 1e6:.1f} MB"
    )
    if status.is_cut_short:
        raise ServiceError(f"{out}: ended early by {status.ended_by}; what was recorded until then is kept")


async def _record(settings: Settings, out: Path, count: int | None) -> LiveRecording:
    calibration = read_rig(settings.rig.calibration_path)
    devices = build_devices(settings.rig.backend_for(calibration))
    source = settings.rig.source(devices, calibration)
    reserve_bytes = settings.recordings.reserve_bytes
    require_room(out.parent, count or 1, source, reserve_bytes)
    recording = LiveRecording(
        # nothing is measured meanwhile: there is processor time for compression
        RecordingWriter(out, source, made_by={"command": "record", "count": count}, compression="zstd"),
        room_needed_bytes=reserve_bytes + source.bundle_bytes,
        count=count,
        on_free=(lambda: None) if devices.belt is None else devices.belt.permit,
    )
    if devices.belt is not None:
        devices.belt.permit(INBOX_TRIGGERS // 2)  # at fast pace; more as these are written
    acquisition = Acquisition(
        devices,
        AcquisitionParameters(
            session=0,
            bundling=settings.rig.bundling_for(settings.bundling),
            min_cameras=settings.views.min,
            empty_rig=settings.empty_rig,
        ),
        on_bundle=recording.offer,
    )

    def end() -> None:
        if acquisition.state is AcquisitionState.STOPPING:  # second request: do not wait for devices
            acquisition.abandon()
        acquisition.stop()

    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, end)
    recording.start()
    acquiring = asyncio.create_task(acquisition.run())
    acquisition.request(AcquisitionTarget.ARMED)
    trouble = await _follow(acquisition, acquiring, recording, count)
    recording.end(EndedBy.STOP)
    await acquiring
    await asyncio.to_thread(devices.close)
    await recording.closed.wait()
    if trouble is not None:
        if is_locked(settings.store.dir):
            trouble += (
                "; the daemon of this configuration is running and controls the rig: record with POST"
                " /api/v1/recordings"
            )
        raise ServiceError(trouble)
    return recording


async def _follow(
    acquisition: Acquisition, acquiring: "asyncio.Task[None]", recording: LiveRecording, count: int | None
) -> str | None:
    """Show the progress until rig or recording have ended; return why the rig could not be armed, None if it was."""
    columns = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[found]}")
    with Progress(*columns, TimeElapsedColumn(), console=Console(stderr=True)) as progress:
        bar = progress.add_task("arming", total=count, found="")
        settled = asyncio.create_task(acquisition.settled.wait())
        await asyncio.wait([settled, acquiring], return_when=asyncio.FIRST_COMPLETED)
        settled.cancel()
        trouble = acquisition.trouble
        while not acquiring.done():
            has_ended = recording.ended_by is not None or recording.closed.is_set()
            if has_ended or trouble is not None or acquisition.state is AcquisitionState.DISARMED:
                acquisition.stop()
            await asyncio.wait([acquiring], timeout=POLL_S)
            found = f"{recording.stones} stones, {acquisition.cameras.armed} of {len(acquisition.cameras.ids)} cameras"
            held = f"held: {acquisition.trouble}" if acquisition.trouble else "recording"
            progress.update(bar, description=held, completed=recording.stones, found=found)
    return trouble
