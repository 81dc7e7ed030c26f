"""The faults that can be switched on in a simulated camera while it runs.

All are off by default, can be changed at any time from any thread, and survive a power cycle. Faults that happen
once and take time (cable pulled, power cycle, control stolen) are methods of the camera.
"""

from dataclasses import asdict, dataclass, fields


@dataclass(slots=True)
class FaultSwitches:
    """Base of fault sets: faults are set, cleared and listed by name."""

    def set(self, name: str, value: object) -> None:
        """Set one fault by name, to a value of a JSON type; raises `ValueError` naming the fault."""
        types = {entry.name: _type_name(entry.type) for entry in fields(self)}
        if name not in types:
            raise ValueError(f"there is no fault {name!r}, but {', '.join(types)}")
        setattr(self, name, _converted(name, types[name], value))

    def clear(self) -> None:
        """Switch all faults off."""
        for entry in fields(self):
            setattr(self, entry.name, entry.default)

    def as_dict(self) -> dict[str, object]:
        return asdict(self)


@dataclass(slots=True)
class Faults(FaultSwitches):
    """Faults of a camera; probabilities are per packet or datagram, counts go down to zero as they strike."""

    # the stream
    packet_loss: float = 0.0  # probability, of resent packets too
    lost_packets: tuple[int, ...] = ()  # of every frame, never when resent; 0 = leader, -1 = trailer
    duplicate: float = 0.0  # probability
    reorder: bool = False  # every seventh packet after the next one
    stall_after: int | None = None  # nothing of a frame after this packet
    no_resend: bool = False  # a request is answered with "packet unavailable"
    swallowed_frames: int = 0  # the next n frames are exposed and counted by the block id, but never sent
    late_ms: float = 0.0  # additional time from the end of the exposure to the leader
    # the image
    wrong_size: bool = False  # half the lines
    corrupted: bool = False  # every other line negative
    frozen: bool = False  # the first image since it was set, again and again
    # triggers
    missed_triggers: int = 0  # the next n edges are not seen
    doubled_triggers: int = 0  # the next n edges expose twice, `DOUBLE_AFTER_MS` apart
    # the control channel
    control_loss: float = 0.0  # probability, of commands and of acknowledgements
    ack_delay_ms: float = 0.0  # pending acknowledgements keep the client waiting from 100 ms on
    # the device
    temperature_c: float | None = None  # reported instead of the simulated one


def _type_name(annotation: object) -> str:
    return annotation.__name__ if isinstance(annotation, type) else str(annotation)


def _converted(name: str, wanted: str, value: object) -> object:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    match wanted, value:
        case ("bool", bool()):
            return value
        case ("int" | "int | None", int()) if is_number and int(value) >= 0:
            return value
        case ("float" | "float | None", int() | float()) if is_number:
            return float(value)
        case ("int | None" | "float | None", None):
            return None
        case ("tuple[int, ...]", list() | tuple()) if all(isinstance(entry, int) for entry in value):
            return tuple(value)
        case _:
            raise ValueError(f"fault {name}: must be {wanted}, not {value!r}")


DOUBLE_AFTER_MS = 30.0
"""From an exposure to the second one of a doubled trigger."""
