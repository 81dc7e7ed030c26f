"""The faults that the faulty twins inject: by index or by chance, the same for the same seed."""

import random
from dataclasses import dataclass

from pipeline.frames import CameraId


@dataclass(frozen=True, slots=True)
class Fault:
    """When a fault strikes: with a probability, and at the given indices of a device's events, counted from 0."""

    probability: float = 0.0
    at: frozenset[int] = frozenset()

    def __post_init__(self) -> None:
        if not 0 <= self.probability <= 1:
            raise ValueError(f"probability must be in 0..1, not {self.probability:g}")


NEVER = Fault()


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultPlan:
    """The faults of a rig's cameras and gate."""

    seed: int = 0
    cameras: frozenset[CameraId] = frozenset()  # the affected ones; empty: all

    lose: Fault = NEVER
    """The frame never arrives."""
    delay: Fault = NEVER
    """The frame arrives together with the camera's next one."""
    duplicate: Fault = NEVER
    """The frame arrives twice."""
    swap: Fault = NEVER
    """The frame has the image of the camera's previous one."""
    freeze: Fault = NEVER
    """From this frame on the image stays the same under new ids."""
    disconnect: Fault = NEVER
    """The camera is lost until it is opened again."""

    lose_trigger: Fault = NEVER
    """The cameras expose, the gate does not announce the stone."""
    double_trigger: Fault = NEVER
    """The gate counts one stone twice."""
    bounce_trigger: Fault = NEVER
    """The beam's edge bounces, and the gate merges the bounce."""
    disconnect_gate: Fault = NEVER
    """The gate is lost until it is opened again."""


class Dice:
    """Random numbers of one device, independent of those of all other devices."""

    def __init__(self, seed: int, device: str) -> None:
        self._random = random.Random(f"{seed}/{device}")  # noqa: S311 - nothing secret

    def strikes(self, fault: Fault, index: int) -> bool:
        """True when a fault strikes the device's event of this index; draws one random number."""
        return (self._random.random() < fault.probability) | (index in fault.at)
