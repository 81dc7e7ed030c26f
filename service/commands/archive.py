"""`stonefall archive`: a recording of the newest stones whose frames the store still has, for `measure` and support."""

import json
import sqlite3
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from drivers.errors import RecordingError
from drivers.files.bundle_file import read_bundle
from drivers.files.recording import RecordingSource, RecordingWriter, open_recording
from drivers.files.rig_file import read_rig
from drivers.files.times import utc_now
from pipeline.fall import Fall
from pipeline.frames import BundleKind, Frame, FrameBundle, Trigger
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation import BackgroundModel
from service.base.errors import UsageError
from service.commands.options import DaemonConfig
from service.configuration.rig_settings import ReplayRigSettings
from service.configuration.settings import Settings, load_settings
from service.processing.backgrounds import read_background
from service.processing.left_bundles import BACKGROUND
from service.store import read
from service.store.history import DATABASE
from service.store.particle_files import RAW, path_of

N_EXPOSURES = 3
"""Exposures of the empty rig that are drawn: the mean of three has hardly more noise than that of more."""


def command(
    out: Annotated[Path, typer.Argument(help="Folder of the recording, which must not be there yet.")],
    config: DaemonConfig,
    newest: Annotated[int, typer.Option(min=1, help="Number of stones.")] = 50,
) -> None:
    """Make a recording of the newest stones whose frames are kept; the daemon may be running, of any release.

    All are of one calibration, that of the newest. The empty rig is not archived: its exposures in the recording are
    drawn from the background that the daemon has, with its noise; without one the network finds the silhouettes.
    """
    settings = load_settings(config)
    state_dir = settings.store.dir
    stones = list(_kept(read(state_dir / DATABASE, _newest_first), state_dir / "particles", newest))
    if not stones:
        raise UsageError(f"{state_dir} has the frames of no stone: [store] keep_raw")
    calibration_id = stones[0][0]["calibration_id"]
    stones = [stone for stone in stones if stone[0]["calibration_id"] == calibration_id]
    rig = _rig_of(calibration_id, settings)
    fall = _fall(settings)
    source = RecordingSource(
        camera_ids=rig.camera_ids,
        rig=rig,
        is_simulated=bool(stones[0][0]["is_simulated"]),
        fall=fall,
        gate_settings={"fall_height_mm": fall.height_mm, "speed_at_gate_mm_s": fall.speed_at_gate_mm_s},
    )
    background = _background(settings)
    with RecordingWriter(out, source, made_by={"command": "archive", "store": str(state_dir)}) as writer:
        for exposure in _exposures(background, rig):
            writer.add(exposure)
        n_written = 0
        for number, (record, frames) in enumerate(reversed(stones), N_EXPOSURES + 1):
            with suppress(RecordingError):  # removed or damaged meanwhile
                bundle = read_bundle(frames, rig.camera_ids)
                writer.add(
                    replace(bundle, trigger=replace(bundle.trigger, sequence=number, name=record["id"]))
                )
                n_written += 1
    empty = f"background of {len(background)} cameras" if background else "no background"
    typer.echo(f"{out}: {n_written} stones, calibration {calibration_id}, {empty}")


def _newest_first(connection: sqlite3.Connection) -> list[tuple[str, str, str]]:
    """Return id, folder and record of the newest stones with files; the columns are those of every release."""
    return connection.execute(
        "SELECT results.id, files.folder, results.record FROM results JOIN files USING (seq)"
        " WHERE files.removed IS NULL ORDER BY seq DESC LIMIT 2000"
    ).fetchall()


def _kept(
    rows: Sequence[tuple[str, str, str]], particles_dir: Path, newest: int
) -> Iterator[tuple[dict[str, Any], Path]]:
    """Yield records and frames of the first `newest` rows that have frames and are stones."""
    for name, folder, text in rows:
        record, frames = json.loads(text), path_of(particles_dir, folder) / RAW
        if newest and record["kind"] == BundleKind.PARTICLE and frames.is_file():
            newest -= 1
            yield {**record, "id": name}, frames


def _rig_of(calibration_id: str, settings: Settings) -> RigCalibration:
    """Return the rig file with an id: one of the store's calibrations, or the configured one."""
    paths = sorted((settings.store.dir / "calibrations").glob("*/rig.json"), reverse=True)
    for path in (*paths, settings.rig.calibration_path):
        with suppress(RecordingError):
            if (rig := read_rig(path)).calibration_id == calibration_id:
                return rig
    raise UsageError(f"calibration {calibration_id} of the newest stones is not kept")


def _fall(settings: Settings) -> Fall:
    rig = settings.rig
    return open_recording(rig.recording).fall if isinstance(rig, ReplayRigSettings) else rig.fall


def _background(settings: Settings) -> BackgroundModel:
    """Return the newest background of the daemon, on tmpfs, else the one kept for its next start, else none."""
    versions = sorted(settings.spool.dir.glob(f"*/*/{BACKGROUND}*"), key=_changed_at, reverse=True)
    for version in versions:
        with suppress(OSError, ValueError, KeyError):  # removed meanwhile
            if found := read_background(version):
                return found
    for kept in settings.store.dir.glob("background-*.npz"):
        with (
            tempfile.TemporaryDirectory(prefix="stonefall-background-") as folder,
            suppress(OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile),
        ):
            with zipfile.ZipFile(kept) as archive:
                archive.extractall(folder)
            return read_background(Path(folder))
    return {}


def _changed_at(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _exposures(background: BackgroundModel, rig: RigCalibration) -> Iterator[FrameBundle]:
    """Yield exposures of the empty rig with mean and noise of the background, the same ones each time."""
    known = {camera.id: background[camera.id] for camera in rig.cameras if camera.id in background}
    rng = np.random.default_rng(0)
    for number in range(1, N_EXPOSURES + 1 if known else 1):
        frames = {}
        for camera, empty in known.items():
            noise = rng.standard_normal(empty.mean.shape, np.float32)
            noise *= np.sqrt(empty.noise.variance_grey2(empty.mean.ravel())).reshape(empty.mean.shape)
            image = np.clip(np.rint(empty.mean + noise), 0, 255).astype(np.uint8)
            frames[camera] = Frame(
                camera=camera, image=image, frame_id=number, device_ns=number, received_ns=number
            )
        trigger = Trigger(
            sequence=number,
            received_ns=number,
            device_ns=number,
            utc=utc_now(),
            kind=BundleKind.BACKGROUND,
            name=f"empty-{number}",
        )
        yield FrameBundle(trigger=trigger, frames=frames)
