"""Which faults the faulty twins inject, and when: by index or by chance, the same for the same seed."""

import random
from dataclasses import dataclass

from pipeline.frames import CameraId


@dataclass(frozen=True, slots=True)
class Fault:
    """Strikes with a probability, and at the given indices (a device's own events, counted from 0)."""

    probability: float = 0.0
    at: frozenset[int] = frozenset()

    def __post_init__(self) -> None:
        if not 0 <= self.probability <= 1:
            raise ValueError(f"probability must be in 0..1, not {self.probability:g}")


NEVER = Fault()


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultPlan:
    """What goes wrong in a rig."""

    seed: int = 0
    cameras: frozenset[CameraId] = frozenset()  # which ones suffer; none named: every one

    lose: Fault = NEVER
    """The frame never arrives."""
    delay: Fault = NEVER
    """The frame arrives together with the camera's next one."""
    duplicate: Fault = NEVER
    """The frame arrives twice."""
    swap: Fault = NEVER
    """The frame shows what the camera's previous one showed."""
    freeze: Fault = NEVER
    """From this frame on the image stays the same under new ids."""
    disconnect: Fault = NEVER
    """The camera is lost until it is opened again."""

    lose_trigger: Fault = NEVER
    """The cameras expose, the gate says nothing."""
    double_trigger: Fault = NEVER
    """The gate counts one stone twice."""
    bounce_trigger: Fault = NEVER
    """The gate's edge bounces and the gate merges it."""
    disconnect_gate: Fault = NEVER
    """The gate is lost until it is opened again."""


class Dice:
    """One device's chances; which fault strikes does not depend on the other devices."""

    def __init__(self, seed: int, device: str) -> None:
        self._random = random.Random(f"{seed}/{device}")  # noqa: S311 - nothing secret

    def strikes(self, fault: Fault, index: int) -> bool:
        return (self._random.random() < fault.probability) | (index in fault.at)
