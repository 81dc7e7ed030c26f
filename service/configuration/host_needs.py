"""What a configuration needs of its host."""

from pathlib import Path

from drivers.errors import RecordingError
from drivers.files.rig_file import read_rig
from drivers.gates.gpio import GpioGateSettings
from service.configuration.rig_settings import AravisRigSettings, ReplayRigSettings
from service.configuration.settings import Settings
from service.host.machine import HostNeeds
from service.host.network import CameraNetwork

BUNDLE_BYTES = 16 * 1280 * 1024
"""Size of a bundle while there is no rig file that tells."""
JUMBO_BYTES = 8192
"""Packets that are worth negotiating for."""


def host_needs(settings: Settings) -> HostNeeds:
    """Return the needs of these settings; a rig file that is missing is named by `problems`, not here."""
    rig, network, gate = settings.rig, None, None
    if isinstance(rig, AravisRigSettings):
        network = CameraNetwork(
            addresses=rig.interfaces or tuple(camera.address for camera in rig.cameras if camera.address),
            receive_buffer_bytes=rig.receive_buffer_bytes,
            packet_bytes=JUMBO_BYTES if rig.packet_size_bytes == "negotiate" else rig.packet_size_bytes,
            uplink_bytes_s=rig.uplink_bytes_s,
        )
    if not isinstance(rig, ReplayRigSettings):
        device = rig.gate.device
        gate = Path(device.chip if isinstance(device, GpioGateSettings) else device.port)
    try:
        cameras = read_rig(rig.calibration_path).cameras
        bundle_bytes = sum(width * height for width, height in (each.image_size_px for each in cameras))
    except RecordingError:
        bundle_bytes = BUNDLE_BYTES
    return HostNeeds(
        network=network,
        gate=gate,
        spool_dir=settings.spool.dir,
        spool_bytes=settings.spool.max_bundles * bundle_bytes,
        store_dir=settings.store.dir,
        min_free_bytes=round(settings.store.retention.min_free_gb * 1e9),
        workers=settings.workers.slots,
    )
