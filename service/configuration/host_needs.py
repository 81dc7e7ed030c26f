"""What a configuration needs of its host."""

from pathlib import Path

from drivers.errors import RecordingError
from drivers.files.rig_file import read_rig
from drivers.gates.gpio import GpioGateSettings
from service.configuration.rig_settings import AravisRigSettings, ReplayRigSettings, RigSettings
from service.configuration.settings import Settings
from service.host.needs import CameraNetwork, HostNeeds

BUNDLE_BYTES = 16 * 1280 * 1024
"""Size of a bundle while there is no rig file that tells."""
JUMBO_BYTES = 8192
"""Packets that are worth negotiating for."""


def host_needs(settings: Settings) -> HostNeeds:
    """Return the needs of these settings; a rig file that is missing is named by `problems`, not here."""
    return HostNeeds(
        network=_network(settings.rig),
        gate=_gate(settings.rig),
        spool_dir=settings.spool.dir,
        spool_bytes=settings.spool.max_bundles * _bundle_bytes(settings.rig.calibration_path),
        store_dir=settings.store.dir,
        min_free_bytes=round(settings.store.retention.min_free_gb * 1e9),
        workers=settings.workers.slots,
    )


def _network(rig: RigSettings) -> CameraNetwork | None:
    if not isinstance(rig, AravisRigSettings):
        return None
    addresses = rig.interfaces or tuple(camera.address for camera in rig.cameras if camera.address)
    return CameraNetwork(
        addresses=addresses,
        receive_buffer_bytes=rig.receive_buffer_bytes,
        packet_bytes=JUMBO_BYTES if rig.packet_size_bytes == "negotiate" else rig.packet_size_bytes,
        uplink_bytes_s=rig.uplink_bytes_s,
    )


def _gate(rig: RigSettings) -> Path | None:
    if isinstance(rig, ReplayRigSettings):
        return None
    gate = rig.gate.device
    return Path(gate.chip if isinstance(gate, GpioGateSettings) else gate.port)


def _bundle_bytes(rig_file: Path) -> int:
    try:
        cameras = read_rig(rig_file).cameras
    except RecordingError:
        return BUNDLE_BYTES
    return sum(width * height for width, height in (camera.image_size_px for camera in cameras))
