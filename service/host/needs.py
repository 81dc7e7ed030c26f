"""Needs of the daemon on its host, by its configuration."""

from dataclasses import dataclass
from pathlib import Path

DAEMON_BYTES, WORKER_BYTES, CALIBRATION_BYTES = 800 << 20, 400 << 20, 500 << 20
"""Memory of the daemon and of a worker, measured, and of a calibration that is solved, reckoned."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraNetwork:
    """The network of the cameras."""

    addresses: tuple[str, ...]  # of this machine towards them, or else theirs
    receive_buffer_bytes: int
    packet_bytes: int
    uplink_bytes_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class HostNeeds:
    """Needs that are checked on the host."""

    network: CameraNetwork | None  # None: a recording is replayed
    gate: Path | None  # device of the light gate; None: a recording is replayed
    spool_dir: Path
    spool_bytes: int  # of all bundles that may wait
    store_dir: Path
    min_free_bytes: int  # of the disk, below which files are removed
    workers: int

    @property
    def memory_bytes(self) -> int:
        """Memory of all processes, the spool on tmpfs included."""
        return DAEMON_BYTES + self.workers * WORKER_BYTES + CALIBRATION_BYTES + self.spool_bytes
