"""Counters of what became of every trigger and every frame: they make losses visible."""

from dataclasses import dataclass, field

from pipeline.frames import CameraId


@dataclass(slots=True, kw_only=True)
class CameraCounters:
    """Counts of what became of one camera's frames."""

    used: int = 0
    missing: int = 0  # bundles without a frame of this camera
    lost: int = 0  # losses that the driver reported
    late: int = 0
    duplicates: int = 0
    extra: int = 0  # several different frames for one trigger
    other_exposure: int = 0
    strays: int = 0  # frames without a trigger
    not_exposed: int = 0  # triggers that its frame ids did not count
    unannounced: int = 0  # exposures without a trigger, by its frame ids
    id_restarts: int = 0


@dataclass(slots=True, kw_only=True)
class BundlingCounters:
    """Totals since the assembler was made; `triggers = complete + incomplete` once nothing is open."""

    triggers: int = 0
    complete: int = 0
    incomplete: int = 0
    in_dead_time: int = 0  # of the incomplete
    orphans: int = 0  # known from their frames alone
    unseen: int = 0  # of the incomplete: counted by the gate, but neither announced nor photographed
    triggers_ignored: int = 0  # merged by the gate itself, or announced when they were orphans already
    triggers_lost: int = 0  # gaps in the gate's counter: orphans and unseen ones
    cameras: dict[CameraId, CameraCounters] = field(default_factory=dict)
