"""The variables of the server: what each shows of the plant, in which unit, and what it is when that is not known."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from operator import attrgetter as of
from typing import Any

from asyncua import ua
from asyncua.ua import ObjectIds as Ids

from pipeline.gradation.estimates import Estimate, State
from service.base.status import Ne107
from service.bridge.opcua.space import Space, engineering_units, node_id
from service.bridge.plant_state import PlantState

ROOT = "VisionSystem"
HEALTH = {
    Ne107.GOOD: "NORMAL",
    Ne107.FAILURE: "FAILURE",
    Ne107.CHECK_FUNCTION: "CHECK_FUNCTION",
    Ne107.OUT_OF_SPECIFICATION: "OFF_SPEC",
    Ne107.MAINTENANCE_REQUIRED: "MAINTENANCE_REQUIRED",
}
"""Words of NAMUR NE 107 in the order and spelling of DeviceHealthEnumeration (OPC 10000-100)."""
VERDICTS = ("not_measured", "insufficient", "undecided", "conforms", "does_not_conform")
"""Words of a verdict; the first is the safe one, for who takes what has no value for 0."""


class VisionState(StrEnum):
    """States of the machine vision system (OPC 40100-1, 8.2 and 8.3), those that occur here."""

    HALTED = "Halted"
    """The daemon is stopping."""
    ERROR = "Error"
    """NE 107 says failure, or the rig is held: no stone is measured."""
    OPERATIONAL = "Operational"
    READY = "Ready"
    """Disarmed, or about to change: stones are ignored until it is armed."""
    CONTINUOUS_EXECUTION = "ContinuousExecution"
    """Armed: every stone is measured."""


NUMBERS: Mapping[VisionState, int] = {
    VisionState.HALTED: 2,
    VisionState.ERROR: 3,
    VisionState.OPERATIONAL: 4,
    VisionState.READY: 6,
    VisionState.CONTINUOUS_EXECUTION: 8,
}
"""`StateNumber` of each in OPC 40100-1."""
MACHINE, MODE = f"{ROOT}.VisionStateMachine", f"{ROOT}.VisionStateMachine.AutomaticModeStateMachine"


def vision_state(state: PlantState) -> VisionState | None:
    """Return the state of the outer machine; None while the daemon does not answer."""
    if state.acquisition is None:
        return None
    if state.acquisition == "stopping":
        return VisionState.HALTED
    if state.ne107 is Ne107.FAILURE or state.acquisition == "held":
        return VisionState.ERROR
    return VisionState.OPERATIONAL


def mode_state(state: PlantState) -> VisionState | None:
    """Return the state of the automatic mode; None unless the outer machine is operational."""
    if vision_state(state) is not VisionState.OPERATIONAL:
        return None
    return VisionState.CONTINUOUS_EXECUTION if state.acquisition == "armed" else VisionState.READY


@dataclass(frozen=True, slots=True)
class Shown:
    """A variable: its path below `VisionSystem`, its type and meaning, and its value in a state of the plant.

    A value of None has the status `unknown`; an `Estimate` of too few stones is uncertain.
    """

    path: str
    data_type: int
    meaning: str
    value: Callable[[PlantState], object]
    unit: str | None = None
    words: Sequence[str] = ()
    is_list: bool = False
    is_always_known: bool = False
    """True for what the bridge knows by itself, also while the daemon does not answer."""
    unknown: int = ua.StatusCodes.BadNoData
    """Status of a value that is None"""

    @property
    def node(self) -> Any:
        """Its identifier."""
        return node_id(f"{ROOT}.{self.path}")

    @property
    def kind(self) -> Any:
        """Its type of variable."""
        if self.words:
            return Ids.MultiStateDiscreteType
        above, _, name = self.path.rpartition(".")
        if name == "CurrentState":
            return Ids.FiniteStateVariableType
        if above.endswith("CurrentState"):
            return Ids.PropertyType
        return Ids.BaseDataVariableType if self.unit is None else Ids.AnalogUnitType


def _time(text: str | None) -> datetime | None:
    return None if text is None else datetime.fromisoformat(text).astimezone(UTC)


def _health(path: str, meaning: str, value: Callable[[PlantState], Ne107 | None]) -> Shown:
    words = tuple(HEALTH.values())

    def number(state: PlantState) -> int | None:
        word = value(state)
        return None if word is None else words.index(HEALTH[word])

    return Shown(path, Ids.Int32, meaning, number, words=words)


def _verdict(path: str, meaning: str, value: Callable[[PlantState], str | None]) -> Shown:
    def number(state: PlantState) -> int | None:
        word = value(state)
        return VERDICTS.index(word) if word in VERDICTS else None

    return Shown(path, Ids.Int32, meaning, number, words=VERDICTS)


def _machine(path: str, meaning: str, value: Callable[[PlantState], VisionState | None]) -> Iterator[Shown]:
    unknown = ua.StatusCodes.BadStateNotActive

    def text(state: PlantState) -> ua.LocalizedText | None:
        return None if (now := value(state)) is None else ua.LocalizedText(now)

    def state_node(state: PlantState) -> ua.NodeId | None:
        return None if (now := value(state)) is None else node_id(f"{ROOT}.{path}.{now}")

    def number(state: PlantState) -> int | None:
        return None if (now := value(state)) is None else NUMBERS[now]

    yield Shown(f"{path}.CurrentState", Ids.LocalizedText, meaning, text, unknown=unknown)
    yield Shown(
        f"{path}.CurrentState.Id", Ids.NodeId, "Node of the current state", state_node, unknown=unknown
    )
    yield Shown(
        f"{path}.CurrentState.Number", Ids.UInt32, "Number of the current state", number, unknown=unknown
    )


def _estimate(
    path: str, unit: str, meaning: str, value: Callable[[PlantState], Estimate | None]
) -> Iterator[Shown]:
    yield Shown(path, Ids.Double, meaning, value, unit)
    for end in ("low", "high"):

        def bound(state: PlantState, end: str = end) -> float | None:
            found = value(state)
            return None if found is None else getattr(found, end)

        which = "Lower" if end == "low" else "Upper"
        yield Shown(f"{path}{end.title()}", Ids.Double, f"{which} end of its 95 % interval", bound, unit)


OBJECTS: Mapping[str, str] = {
    "VisionStateMachine": "What the system does now (OPC 40100-1, 8.2)",
    "VisionStateMachine.AutomaticModeStateMachine": "What it does while it is operational (OPC 40100-1, 8.3)",
    "Lot": "The lot in which stones fall now",
    "LastLot": "The lot that was closed last, and is not void",
    "Figures": "Figures of the open lot, else of the last hour",
    "Counts": "Stones since the beginning of the history",
    "Alarms": "Alarms that need an operator",
    "ResultManagement": "Results of stones (OPC 40100-1)",
    "ResultManagement.LatestResult": "The newest result",
}
"""Objects below `VisionSystem`."""

SHOWN: tuple[Shown, ...] = (
    Shown("DaemonAnswers", Ids.Boolean, "False: all else is Bad until it answers again",
          of("daemon_answers"), is_always_known=True),
    Shown("Trouble", Ids.String, "Why the daemon does not answer; empty when it does",
          lambda state: state.trouble or "", is_always_known=True),
    Shown("Rig", Ids.String, "Plant, line and serial number", of("rig")),
    Shown("IsSimulated", Ids.Boolean, "True when images are synthetic, or a recording is played: never bill it",
          lambda state: state.is_simulated or state.is_replay),
    Shown("Ready", Ids.Boolean, "True when the next stone will be measured", of("ready")),
    Shown("Reasons", Ids.String, "Why it is not ready, or not NORMAL", lambda state: list(state.reasons), is_list=True),
    Shown("CalibrationId", Ids.String, "Calibration that stones are measured with", of("calibration_id")),
    _health("DeviceHealth", "State of the system, NAMUR NE 107", of("ne107")),
    _health("GateHealth", "State of the light gate", lambda state: state.components.get("gate")),
    _health("RigHealth", "State of geometry and optics: is all as it was calibrated",
            lambda state: state.components.get("rig")),
    Shown("Cameras", Ids.String, "Each camera with its state, such as `c01 NORMAL`", lambda state: [
        f"{name} {HEALTH[word]}" for name, word in state.components.items() if name not in ("gate", "rig")],
          is_list=True),
    *_machine("VisionStateMachine", "Halted, Error or Operational", vision_state),
    *_machine("VisionStateMachine.AutomaticModeStateMachine", "Ready or ContinuousExecution", mode_state),
    Shown("Lot.IsOpen", Ids.Boolean, "True while a lot is open; else all below has no data",
          lambda state: state.lot is not None),
    Shown("Lot.Name", Ids.String, "Id of the lot", of("lot")),
    Shown("Lot.Product", Ids.String, "Id of its product", of("product")),
    Shown("Lot.Title", Ids.String, "Name of the product for people", of("product_title")),
    Shown("Lot.OpenedAt", Ids.UtcTime, "When it was opened", lambda state: _time(state.opened_at)),
    Shown("Lot.Stones", Ids.UInt64, "Stones that fell, whatever became of them", of("n_stones")),
    _verdict("Lot.Verdict", "Verdict so far; that of the completed lot counts", of("verdict")),
    Shown("LastLot.Name", Ids.String, "Id of the lot", of("last_lot")),
    _verdict("LastLot.Verdict", "Its final verdict; no data until its figures are final", of("last_verdict")),
    *_estimate("Figures.D50", "mm", "Size that half of the mass is smaller than", of("d50_mm")),
    *_estimate("Figures.FI", "percent", "Flakiness index, EN 933-3", of("flakiness_percent")),
    *_estimate("Figures.SI", "percent", "Shape index, EN 933-4", of("shape_percent")),
    Shown("Figures.IsPartial", Ids.Boolean, "True when some figures of the specification were not measured",
          of("is_partial")),
    Shown("Counts.StonesPerMinute", Ids.Double, "Stones in the last minute",
          lambda state: None if state.stones_per_min is None else float(state.stones_per_min), "per_min"),
    Shown("Counts.Triggers", Ids.UInt64, "All that the light gate announced, those without an outcome yet included",
          of("triggers")),
    Shown("Counts.Measured", Ids.UInt64, "Stones with a body and its measures", of("measured")),
    Shown("Counts.Rejected", Ids.UInt64, "Stones whose views were unfit", of("rejected")),
    Shown("Counts.Lost", Ids.UInt64, "Stones whose views were never looked at", of("lost")),
    Shown("Alarms.Unacknowledged", Ids.UInt32, "Alarms that nobody has acknowledged",
          lambda state: sum(each.state != "acknowledged" for each in state.alarms)),
    Shown("Alarms.Active", Ids.UInt32, "Alarms whose cause is there",
          lambda state: sum(each.state != "returned" for each in state.alarms)),
    Shown("Alarms.Texts", Ids.String, "Each alarm: priority, state, check, what it says; the most urgent first",
          lambda state: [f"{each.priority} {each.state} {each.check}: {each.detail or ''}" for each in state.alarms],
          is_list=True),
    Shown("ResultManagement.LastSeq", Ids.UInt64, "seq of the newest result at the daemon", of("last_seq")),
)  # fmt: skip
"""All variables that follow from the state of the plant."""


async def add_shown(space: Space) -> None:
    """Add objects and variables to an address space."""
    kinds = {
        "VisionStateMachine": Ids.FiniteStateMachineType,
        MODE[len(ROOT) + 1 :]: Ids.FiniteStateMachineType,
    }
    await space.add_object(
        ROOT, "Measures every stone that falls through the rig", parent=ua.NodeId(Ids.ObjectsFolder),
        reference=Ids.Organizes,
    )  # fmt: skip
    for path, meaning in OBJECTS.items():
        await space.add_object(f"{ROOT}.{path}", meaning, kinds.get(path, Ids.BaseObjectType))
    for state, number in NUMBERS.items():
        path = f"{MACHINE if number < NUMBERS[VisionState.READY] else MODE}.{state}"
        await space.add_object(path, "", Ids.StateType)
        await space.add_property(f"{path}.StateNumber", ua.Variant(number, ua.VariantType.UInt32), Ids.UInt32)
    for shown in SHOWN:
        await add_variable(space, shown)


async def add_variable(space: Space, shown: Shown) -> None:
    """Add a variable, with its unit or words."""
    path = f"{ROOT}.{shown.path}"
    await space.add_variable(
        path, shown.meaning, shown.data_type, is_list=shown.is_list, kind=shown.kind
    )  # fmt: skip
    if shown.unit is not None:
        unit = ua.Variant(engineering_units(shown.unit), ua.VariantType.ExtensionObject)
        await space.add_property(f"{path}.EngineeringUnits", unit, Ids.EUInformation)
    if shown.words:
        words = ua.Variant([ua.LocalizedText(word) for word in shown.words])
        await space.add_property(f"{path}.EnumStrings", words, Ids.LocalizedText)


def data_value(shown: Shown, state: PlantState, now: datetime) -> ua.DataValue:
    """Return a variable's value with the daemon's time, Bad where it is unknown, Uncertain where not sure."""
    time = _time(state.at) or now
    status = ua.StatusCodes.Good
    if not state.daemon_answers and not shown.is_always_known:
        return _without_value(ua.StatusCodes.BadNoCommunication, now)
    value = shown.value(state)
    if isinstance(value, Estimate):
        if value.state is State.INSUFFICIENT:
            status = ua.StatusCodes.UncertainSubNormal
        value = None if value.state is State.NOT_MEASURED else value.value
    if value is None:
        return _without_value(shown.unknown, time)
    return with_value(value, shown, time, status)


def with_value(
    value: object, shown: Shown, time: datetime, status: int = ua.StatusCodes.Good
) -> ua.DataValue:
    """Return a value with its type, status and time."""
    kind = ua.VariantType.DateTime if shown.data_type == Ids.UtcTime else ua.VariantType(shown.data_type)
    variant = ua.Variant(value, kind, is_array=shown.is_list)
    return ua.DataValue(variant, ua.StatusCode(status), SourceTimestamp=time, ServerTimestamp=time)


def _without_value(status: int, time: datetime) -> ua.DataValue:
    return ua.DataValue(ua.Variant(None), ua.StatusCode(status), SourceTimestamp=time, ServerTimestamp=time)
