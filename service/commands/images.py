"""`stonefall import` and `export`: recordings from PNG images and back, a folder for each bundle."""

import re
import sys
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track

from drivers.errors import RecordingError
from drivers.files.durable import new_folder
from drivers.files.png_file import read_png, write_png
from drivers.files.recording import (
    RecordingSource,
    RecordingWriter,
    open_recording,
    playback_order,
    read_bundle,
)
from drivers.files.rig_file import read_rig, write_rig
from drivers.interfaces import FrameLossReason
from pipeline.frames import BundleKind, CameraId, Frame, FrameBundle, Trigger, rfc3339
from pipeline.rig.cameras import RigCalibration
from service.base.errors import UsageError

SPACING_NS = 250_000_000
EXPOSURE_DELAY_NS = 247_400_000
TRANSFER_NS = 12_000_000
"""Times that are given to the images, which carry none: those of the paper's rig at four stones a second."""


def import_command(
    source: Annotated[
        Path, typer.Argument(help="Folder with a folder for each bundle and in it <camera id>.png.")
    ],
    out: Annotated[Path, typer.Argument(help="Folder of the new recording.")],
    rig: Annotated[Path, typer.Option(help="Rig file of the cameras.")],
    background: Annotated[
        list[str] | None,
        typer.Option(help="Name of a bundle's folder that shows the empty rig; may be repeated."),
    ] = None,
    simulated: Annotated[bool, typer.Option("--simulated", help="Mark the images as synthetic.")] = False,
) -> None:
    """Make a recording from folders of 8-bit grey PNG images; a missing file means a missing view."""
    calibration = read_rig(rig)
    folders = _bundle_folders(source, background or [])
    started_at = datetime.now(UTC)
    with RecordingWriter(
        out,
        RecordingSource(camera_ids=calibration.camera_ids, rig=calibration, is_simulated=simulated),
        made_by={"command": "import", "source": source.name, "times": "invented"},
    ) as writer:
        console = Console(file=sys.stderr)
        for sequence, (folder, kind) in enumerate(track(folders, "importing", console=console)):
            writer.add(_bundle(folder, kind, sequence, calibration, started_at))


def export_command(
    recording: Annotated[Path, typer.Argument(help="Folder of the recording.")],
    out: Annotated[
        Path, typer.Argument(help="New folder, with a folder for each bundle and in it <camera id>.png.")
    ],
) -> None:
    """Write a recording as PNG images, with its rig.json.

    backgrounds.txt lists the bundles that show the empty rig. Damaged images are left out and named.
    """
    source = open_recording(recording)
    console = Console(file=sys.stderr)
    left_out = [str(error) for error in source.unreadable]
    with new_folder(out) as folder:
        backgrounds = []
        for header in track(playback_order(source), "exporting", console=console):
            try:
                bundle = read_bundle(header.path, source.camera_ids)
            except RecordingError as err:
                left_out.append(str(err))
                continue
            left_out += [
                f"{header.path}: camera {camera} is damaged"
                for camera, reason in bundle.missing.items()
                if reason == FrameLossReason.DAMAGED
            ]
            (folder / bundle.name).mkdir()
            for camera, frame in bundle.frames.items():
                write_png(folder / bundle.name / f"{camera}.png", frame.image)
            if bundle.kind is BundleKind.BACKGROUND:
                backgrounds.append(bundle.name)
        (folder / "backgrounds.txt").write_text(
            "".join(f"{name}\n" for name in backgrounds), encoding="utf-8"
        )
        if source.rig is not None:
            write_rig(folder / "rig.json", source.rig)
    for problem in left_out:
        console.print(f"left out: {problem}", markup=False, highlight=False, soft_wrap=True)


def _bundle_folders(source: Path, backgrounds: Sequence[str]) -> list[tuple[Path, BundleKind]]:
    """Return the folders in the order of their names, numbers by value, those of the empty rig first."""
    if not source.is_dir():
        raise RecordingError(source, "is not a folder")
    folders = [path for path in source.iterdir() if path.is_dir() and not path.name.startswith(".")]
    if not folders:
        raise RecordingError(source, "has no folder of images")
    if unknown := sorted(set(backgrounds) - {folder.name for folder in folders}):
        raise UsageError(f"--background {unknown[0]}: {source} has no such folder")

    def sort_key(folder: Path) -> tuple[bool, list[tuple[int, str]], str]:
        numbers_and_words = re.findall(r"(\d+)|(\D+)", folder.name)
        key = [(int(number or 0), word) for number, word in numbers_and_words]
        return folder.name not in backgrounds, key, folder.name

    return [
        (folder, BundleKind.BACKGROUND if folder.name in backgrounds else BundleKind.PARTICLE)
        for folder in sorted(folders, key=sort_key)
    ]


def _bundle(
    folder: Path, kind: BundleKind, sequence: int, rig: RigCalibration, started_at: datetime
) -> FrameBundle:
    files = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() == ".png":
            if path.stem not in rig.camera_ids:
                raise RecordingError(path, f"{path.stem!r} is no camera of the rig")
            files[CameraId(path.stem)] = path
    if not files:
        raise RecordingError(folder, "has no image <camera id>.png")
    trigger_ns = (sequence + 1) * SPACING_NS
    utc = started_at + timedelta(microseconds=trigger_ns / 1000)
    frames = {
        camera: Frame(
            camera=camera,
            image=read_png(path, rig.cameras[0].image_size_px),
            frame_id=sequence + 1,
            device_ns=trigger_ns + EXPOSURE_DELAY_NS,
            received_ns=trigger_ns + EXPOSURE_DELAY_NS + TRANSFER_NS,
        )
        for camera, path in files.items()
    }
    return FrameBundle(
        trigger=Trigger(
            sequence=sequence,
            received_ns=trigger_ns,
            device_ns=trigger_ns,
            utc=rfc3339(utc),
            kind=kind,
            name=folder.name,
        ),
        frames=frames,
        missing={camera: "no_image" for camera in rig.camera_ids if camera not in files},
    )
