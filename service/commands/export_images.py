"""`stonefall export`: write the images of a recording in the layout that `stonefall import` reads."""

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track

from drivers.errors import RecordingError
from drivers.files.durable import new_folder
from drivers.files.png_file import write_png
from drivers.files.recording import open_recording, playback_order, read_bundle
from drivers.files.rig_file import write_rig
from drivers.interfaces import FrameLossReason
from pipeline.frames import BundleKind


def command(
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
