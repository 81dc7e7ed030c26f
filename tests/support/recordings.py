"""Small rigs and recordings: four cameras of 64 x 48 pixels, every image different."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.files.recording import RecordingSource, RecordingWriter
from pipeline.frames import BundleKind, CameraId, Frame, FrameBundle, Image, Trigger
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import nominal_rig

SIZE_PX = (64, 48)
CAMERAS = tuple(CameraId(f"c{i:02d}") for i in range(1, 5))
SPACING_NS = 250_000_000
DELAY_NS = 259_400_000


def small_rig(camera_ids: Sequence[CameraId] = CAMERAS) -> RigCalibration:
    rig = nominal_rig()
    K = np.array([[312.5, 0, (SIZE_PX[0] - 1) / 2], [0, 312.5, (SIZE_PX[1] - 1) / 2], [0, 0, 1]])
    cameras = tuple(
        replace(camera, id=camera_id, image_size_px=SIZE_PX, K=K.copy())
        for camera_id, camera in zip(camera_ids, rig.cameras, strict=False)
    )
    return replace(rig, name="small", cameras=cameras)


SOURCE = RecordingSource(camera_ids=CAMERAS, rig=small_rig(), is_simulated=True)


def tagged_image(sequence: int, camera: CameraId, size_px: tuple[int, int] = SIZE_PX) -> Image:
    """The one image (H, W) of this camera for this trigger."""
    rng = np.random.default_rng([sequence, int(camera[1:])])
    return rng.integers(0, 256, size_px[::-1], dtype=np.uint8)


def make_bundle(
    sequence: int,
    *,
    kind: BundleKind = BundleKind.PARTICLE,
    missing: Mapping[CameraId, str] | None = None,
    name: str | None = None,
    camera_ids: Sequence[CameraId] = CAMERAS,
) -> FrameBundle:
    trigger_ns = 1_000_000_000 + sequence * SPACING_NS
    missing = missing or {}
    frames = {
        camera: Frame(
            camera=camera,
            image=tagged_image(sequence, camera),
            frame_id=sequence + 1,
            device_ns=7_000_000_000 * (i + 1) + trigger_ns,
            received_ns=trigger_ns + DELAY_NS + 1_000_000 * i,
        )
        for i, camera in enumerate(camera_ids)
        if camera not in missing
    }
    trigger = Trigger(
        sequence=sequence,
        received_ns=trigger_ns,
        device_ns=trigger_ns,
        utc=f"2026-01-01T00:00:{sequence % 60:02d}Z",
        pulse_width_ns=4_000_000,
        kind=kind,
        name=name,
    )
    return FrameBundle(trigger=trigger, frames=frames, missing=missing)


def write_recording(path: Path, bundles: Iterable[FrameBundle], *, is_simulated: bool = True) -> Path:
    source = replace(SOURCE, is_simulated=is_simulated)
    with RecordingWriter(path, source, made_by={"command": "test"}) as writer:
        for bundle in bundles:
            writer.add(bundle)
    return path


def assert_same_bundle(found: FrameBundle, expected: FrameBundle) -> None:
    assert found.trigger == expected.trigger
    assert dict(found.missing) == dict(expected.missing)
    assert set(found.frames) == set(expected.frames)
    for camera, frame in expected.frames.items():
        same = found.frames[camera]
        assert np.array_equal(same.image, frame.image)
        assert (same.frame_id, same.device_ns, same.received_ns) == (
            frame.frame_id,
            frame.device_ns,
            frame.received_ns,
        )
