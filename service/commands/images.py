"""`stonefall import` and `export`: recordings from images and back, a folder for each bundle."""

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import track

from drivers.errors import RecordingError
from drivers.files.bounded import read_bounded
from drivers.files.durable import MAX_JSON_BYTES, new_folder
from drivers.files.image_file import GREY_BITS, read_image, write_png
from drivers.files.image_folder import camera_images, exposure_folders
from drivers.files.recording import (
    RecordingSource,
    RecordingWriter,
    open_recording,
    playback_order,
    read_bundle,
)
from drivers.files.rig_file import is_rig_file, read_foreign_rig, read_rig, write_rig
from drivers.interfaces import FrameLossReason
from pipeline.frames import BundleKind, CameraId, Frame, FrameBundle, Image, Trigger, rfc3339
from pipeline.rig.camera_arrays import camera_arrays
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.placing import Placement
from service.base.errors import UsageError
from service.base.tables.lines import text_of
from service.commands.imported_images import ImageReader
from service.commands.options import with_options

RIG, BACKGROUNDS = "rig.json", "backgrounds.txt"
"""Files that `export` writes beside the folders of bundles."""
SPACING_NS = 250_000_000
EXPOSURE_DELAY_NS = 247_400_000
TRANSFER_NS = 12_000_000
"""Times that are given to the images, which carry none: those of the paper's rig at four stones a second."""


@dataclass(frozen=True, slots=True)
class ImportOptions:
    source: Annotated[Path, typer.Argument()]
    """Folder with a folder for each bundle and in it <camera id>.png or .tif."""
    out: Annotated[Path, typer.Argument()]
    """Folder of the new recording."""
    rig: Path
    """Rig file of the cameras; or cameras of another program: a folder of COLMAP or OpenCV, a transforms.json of
    Blender, a text of matrices."""
    background: list[str] | None = None
    """Name of a bundle's folder that shows the empty rig; may be repeated. Default: those in backgrounds.txt."""
    simulated: bool = False
    """Mark the images as synthetic."""
    bits: Annotated[int | None, typer.Option(min=9, max=16)] = None
    """Bits that the camera gave for each pixel, where files of 16 bits hold fewer: 10, 12 or 14."""
    masks: bool = False
    """The images are masks of two grey levels, that of their border is the background."""
    mm_per_unit: Annotated[float | None, typer.Option(min=1e-6, max=1e6)] = None
    """Unit of lengths in such a file, mm; default: 1."""
    origin: str | None = None
    """Point of its world that becomes the rig's centre: X,Y,Z in its units, or axes for the one nearest to all
    optical axes; default: 0,0,0."""


@with_options
def import_command(options: ImportOptions) -> None:
    """Make a recording from folders of grey PNG or TIFF images; a missing file means a missing view.

    Of more than 8 bits the upper 8 are kept. What is not imported is named.
    """
    calibration = _calibration(options)
    folders, left_out = _bundle_folders(options.source, options.background)
    left_out = [path for path in left_out if path.name not in (RIG, BACKGROUNDS)]
    started_at = datetime.now(UTC)
    reader = ImageReader(options.source, calibration.cameras[0].image_size_px, options.bits, options.masks)
    with RecordingWriter(
        options.out,
        RecordingSource(
            camera_ids=calibration.camera_ids,
            rig=calibration,
            is_simulated=options.simulated,
            holds_masks=options.masks,
        ),
        made_by={"command": "import", "source": options.source.name, "times": "invented"},
    ) as writer:
        console = Console(file=sys.stderr)
        for sequence, (folder, kind) in enumerate(track(folders, "importing", console=console)):
            files, others = camera_images(folder, calibration.camera_ids)
            left_out += others
            images = {camera: reader.read(path) for camera, path in files.items()}
            writer.add(_bundle(folder.name, kind, sequence, images, calibration, started_at))
        reader.require_known_depth()
    for bits, count in sorted(reader.depths.items()):
        if bits > GREY_BITS:
            console.print(f"{count} images of {bits} bits: the upper {GREY_BITS} are kept")
    if left_out:
        console.print(f"{len(left_out)} left out, neither PNG nor TIFF in the folder of a bundle:")
    _tell_left_out(console, map(str, left_out))


def export_command(
    recording: Annotated[Path, typer.Argument(help="Folder of the recording.")],
    out: Annotated[
        Path, typer.Argument(help="New folder, with a folder for each bundle and in it <camera id>.png.")
    ],
) -> None:
    """Write a recording as PNG images, with its rig.json.

    backgrounds.txt lists the bundles that show the empty rig. Damaged images are left out and named.
    """
    source = open_recording(recording, takes_masks=True)
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
        (folder / BACKGROUNDS).write_text("".join(f"{name}\n" for name in backgrounds), encoding="utf-8")
        if source.rig is not None:
            write_rig(folder / RIG, source.rig)
    _tell_left_out(console, left_out)


def _calibration(options: ImportOptions) -> RigCalibration:
    """Return the rig of the images; cameras of another program are described on stderr, for people to compare."""
    if is_rig_file(options.rig):
        if options.mm_per_unit is not None or options.origin is not None:
            raise UsageError(f"{options.rig} is a rig file, in mm: leave --mm-per-unit and --origin out")
        return read_rig(options.rig)
    first = next(iter(camera_images(exposure_folders(options.source)[0][0])[0].values()))
    height_px, width_px = read_image(first).pixels.shape
    placement = Placement(mm_per_unit=options.mm_per_unit or 1.0, origin=_origin(options.origin))
    rig = read_foreign_rig(options.rig, (width_px, height_px), placement)
    cameras = camera_arrays(rig.cameras)
    distances_mm = np.linalg.norm(cameras.centers_mm, axis=1)
    misses_mm = np.linalg.norm(np.cross(cameras.centers_mm, cameras.R[:, 2]), axis=1)
    fields_mm = rig.cameras[0].image_size_px[0] * distances_mm / cameras.focals_px
    typer.echo(
        f"{len(rig.cameras)} cameras, {placement}: {distances_mm.min():.1f} to {distances_mm.max():.1f} mm from it,"
        f" which their axes pass by {misses_mm.max():.2f} mm at most; images there are {fields_mm.min():.1f} to"
        f" {fields_mm.max():.1f} mm wide",
        err=True,
    )
    return rig


def _origin(text: str | None) -> tuple[float, float, float] | None:
    """Return the point that an option names; None for the one nearest to the axes."""
    if text == "axes":
        return None
    try:
        x, y, z = map(float, (text or "0,0,0").split(","))
    except ValueError as err:
        raise typer.BadParameter(f"{text!r} is neither X,Y,Z nor axes", param_hint="--origin") from err
    return x, y, z


def _tell_left_out(console: Console, left_out: Iterable[str]) -> None:
    for problem in left_out:
        console.print(f"left out: {problem}", markup=False, highlight=False, soft_wrap=True)


def _bundle_folders(
    source: Path, backgrounds: Sequence[str] | None
) -> tuple[list[tuple[Path, BundleKind]], list[Path]]:
    """Return the folders in their order, those of the empty rig first, and the files beside them."""
    folders, files = exposure_folders(source)
    if backgrounds is None:
        listed = source / BACKGROUNDS
        lines = text_of(read_bounded(listed, MAX_JSON_BYTES)).splitlines() if listed.is_file() else []
        backgrounds = [name for line in lines if (name := line.strip())]
    if unknown := sorted(set(backgrounds) - {folder.name for folder in folders}):
        raise UsageError(f"background {unknown[0]}: {source} has no such folder")
    kinds = [
        (folder, BundleKind.BACKGROUND if folder.name in backgrounds else BundleKind.PARTICLE)
        for folder in folders
    ]
    return sorted(kinds, key=lambda each: each[1] is not BundleKind.BACKGROUND), files


def _bundle(
    name: str,
    kind: BundleKind,
    sequence: int,
    images: Mapping[CameraId, Image],
    rig: RigCalibration,
    started_at: datetime,
) -> FrameBundle:
    trigger_ns = (sequence + 1) * SPACING_NS
    utc = started_at + timedelta(microseconds=trigger_ns / 1000)
    frames = {
        camera: Frame(
            camera=camera,
            image=image,
            frame_id=sequence + 1,
            device_ns=trigger_ns + EXPOSURE_DELAY_NS,
            received_ns=trigger_ns + EXPOSURE_DELAY_NS + TRANSFER_NS,
        )
        for camera, image in images.items()
    }
    return FrameBundle(
        trigger=Trigger(
            sequence=sequence,
            received_ns=trigger_ns,
            device_ns=trigger_ns,
            utc=rfc3339(utc),
            kind=kind,
            name=name,
        ),
        frames=frames,
        missing={camera: "no_image" for camera in rig.camera_ids if camera not in images},
    )
