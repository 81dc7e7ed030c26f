"""What was seen of each ball (or stone) of a calibration, on disk.

`<number>.npz` has the outlines, `<number>.json` what people look at. The second is written last: a drop without
it was never there.
"""

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from drivers.files.durable import replacing, write_json
from pipeline.calibration import BallDrop, BallView
from pipeline.frames import CameraId
from service.calibration.files import read_document

HEADER = "header.json"
"""Name of the array beside those of the cameras; a camera id has no dot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenCircle:
    """An image in one view: about where, and how large."""

    center_uv: tuple[float, float]
    radius_px: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservedDrop:
    """One drop against the calibration it was measured with, in a few numbers."""

    bundle: str
    diameter_mm: float | None = None  # of the balls that were entered, the one that it can only be
    views: Mapping[CameraId, SeenCircle] = field(default_factory=dict)  # that show it whole
    refused: Mapping[CameraId, str] = field(default_factory=dict)  # views left out, with the reason
    center_mm: tuple[float, float, float] | None = None
    residuals_px: Mapping[CameraId, float] = field(default_factory=dict)
    vertical_minus_horizontal_mm: float | None = None  # of a ball's diameter
    problem: str | None = None  # why nothing was observed


def rough_drop(drop: ObservedDrop) -> BallDrop:
    """The same without outlines: enough to judge what the drops cover."""
    return BallDrop(
        name=drop.bundle,
        diameter_mm=drop.diameter_mm,
        views={
            camera: BallView(
                outline_uv=np.zeros((0, 2)),
                center_uv=np.array(circle.center_uv),
                radius_px=circle.radius_px,
                rms_px=0.0,
            )
            for camera, circle in drop.views.items()
        },
        refused=drop.refused,
    )


def write_drop(path: Path, drop: BallDrop) -> None:
    """Write outlines as npz."""
    header = {
        "name": drop.name,
        "diameter_mm": drop.diameter_mm,
        "refused": dict(drop.refused),
        "fall_ns": drop.fall_ns,
        "views": {
            camera: {
                "center_uv": view.center_uv.tolist(),
                "radius_px": view.radius_px,
                "rms_px": view.rms_px,
            }
            for camera, view in drop.views.items()
        },
    }
    arrays: dict[str, Any] = {camera: view.outline_uv for camera, view in drop.views.items()}
    arrays[HEADER] = np.array(json.dumps(header))
    with path.open("wb") as file:
        np.savez(file, **arrays)


def read_drop(path: Path) -> BallDrop:
    """The drop in a file written by `write_drop`."""
    with path.open("rb") as file, np.load(file) as arrays:
        header = json.loads(str(arrays[HEADER]))
        views = {
            CameraId(camera): BallView(
                outline_uv=arrays[camera],
                center_uv=np.array(view["center_uv"]),
                radius_px=view["radius_px"],
                rms_px=view["rms_px"],
            )
            for camera, view in header["views"].items()
        }
    return BallDrop(
        name=header["name"],
        diameter_mm=header["diameter_mm"],
        views=views,
        refused=header["refused"],
        fall_ns=header["fall_ns"],
    )


def keep_drop(folder: Path, drop: ObservedDrop, outlines_path: Path | None) -> None:
    """Keep a drop durably, behind those that are there; `outlines_path` is None when nothing was observed."""
    path = folder / f"{len(list(folder.glob('*.json'))) + 1:05d}.npz"
    path.unlink(missing_ok=True)  # of a drop that was never there
    if outlines_path is not None:
        with replacing(path) as unfinished:
            shutil.copyfile(outlines_path, unfinished)
    write_json(path.with_suffix(".json"), TypeAdapter(ObservedDrop).dump_python(drop, mode="json"))


def kept_drops(folder: Path) -> list[ObservedDrop]:
    """All drops of a folder, in order; raises `RecordingError` when one is damaged."""
    adapter = TypeAdapter(ObservedDrop)
    return [read_document(path, adapter) for path in sorted(folder.glob("*.json"))]


def outline_paths(folder: Path) -> list[Path]:
    """The outlines of all drops of which something was observed, in order."""
    return [path for each in sorted(folder.glob("*.json")) if (path := each.with_suffix(".npz")).exists()]
