"""What the daemon says of itself, as coded data: an English text that knows the codes and parameters it is made of.

`words/messages.toml` has the words of every code in all languages, and those of what a message may be about. Pages get
them with their other words, so a page never shows the English text in another language.
"""

import re
import tomllib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from enum import StrEnum
from functools import cache
from typing import Annotated, Any

from pydantic import WrapValidator

from drivers.errors import DeviceFault, Told
from service.base.language import FOLDER, Language
from service.base.schema import served

Value = str | int | float
"""A parameter: a figure in the unit of its name, ids, or a text of others, such as the operating system's."""


class Code(StrEnum):
    """What a message says; clients decide by it."""

    REPORTED = "reported"
    """A text that another program or a device has made, in its own words."""
    DEVICE_SILENT = "device_silent"
    DEVICE_WRONG_CAMERA = "device_wrong_camera"
    DEVICE_IN_USE = "device_in_use"
    DEVICE_CONTROL_LOST = "device_control_lost"
    DEVICE_WRONG_SETTINGS = "device_wrong_settings"
    DEVICE_PROCESS_ENDED = "device_process_ended"
    DEVICE_OTHER = "device_other"
    BEAM_CLOSED = "beam_closed"
    GATE_LINES_LATE = "gate_lines_late"
    GATE_RESTARTED = "gate_restarted"
    GATE_CLOCK_SHORT = "gate_clock_short"
    GATE_CANNOT_DELAY = "gate_cannot_delay"
    GATE_DELAY_REFUSED = "gate_delay_refused"
    GATE_DELAY_DIFFERS = "gate_delay_differs"
    GATE_PULSES_UNMADE = "gate_pulses_unmade"
    GATE_LINES_UNKNOWN = "gate_lines_unknown"
    GATE_PORT_MISSING = "gate_port_missing"
    GATE_FIRMWARE_OLD = "gate_firmware_old"
    GATE_PORT_DENIED = "gate_port_denied"
    GATE_PORT_TAKEN = "gate_port_taken"
    GATE_PORT_UNUSABLE = "gate_port_unusable"
    GATE_NO_MODEM_LINES = "gate_no_modem_lines"
    GATE_NO_CTS = "gate_no_cts"
    GATE_GPIO_UNUSABLE = "gate_gpio_unusable"
    GATE_GPIOD_MISSING = "gate_gpiod_missing"
    GATE_UNIDENTIFIED = "gate_unidentified"
    GATE_NOISE = "gate_noise"
    GATE_FOREIGN = "gate_foreign"
    GATE_MUTE = "gate_mute"
    GATE_GONE = "gate_gone"
    DEVICE_DISCONNECTED = "device_disconnected"
    RECEIVE_BUFFER_SMALL = "receive_buffer_small"
    LINK_SLOW = "link_slow"
    CLOCK_WITHOUT_MASTER = "clock_without_master"
    CLOCK_MASTERS = "clock_masters"
    FEATURE_PUT_BACK = "feature_put_back"
    FEATURE_STAYS = "feature_stays"
    ENTRY_INSTEAD = "entry_instead"
    CAMERA_SENDS_NOTHING = "camera_sends_nothing"
    CAMERA_FROZEN = "camera_frozen"
    CAMERA_SKEWED = "camera_skewed"
    CAMERA_MISSES = "camera_misses"
    CAMERA_LOSES = "camera_loses"
    CAMERAS_SILENT = "cameras_silent"
    CAMERAS_LOST = "cameras_lost"
    CAMERAS_NEEDED = "cameras_needed"
    CAMERA_PROCESS_SILENT = "camera_process_silent"
    CAMERA_PROCESS_REPLACED = "camera_process_replaced"
    TRIGGER_LINE_BLIND = "trigger_line_blind"
    GATE_SILENT = "gate_silent"
    GATE_UNANNOUNCED = "gate_unannounced"
    GATE_LATE = "gate_late"
    GATE_COUNTED = "gate_counted"
    GATE_EDGES_MISSED = "gate_edges_missed"
    GATE_EARLY = "gate_early"
    ACQUISITION_DISARMED = "acquisition_disarmed"
    ACQUISITION_ARMING = "acquisition_arming"
    ACQUISITION_ARMED = "acquisition_armed"
    ACQUISITION_HELD = "acquisition_held"
    ACQUISITION_DISARMING = "acquisition_disarming"
    ACQUISITION_STOPPING = "acquisition_stopping"
    WEBHOOK_DISABLED = "webhook_disabled"
    WEBHOOK_FAILING = "webhook_failing"
    WEBHOOK_UNREADABLE = "webhook_unreadable"
    MAIL_SILENT = "mail_silent"
    MAIL_FAILING = "mail_failing"
    MAIL_REFUSED = "mail_refused"
    FILES_NOT_WRITTEN = "files_not_written"
    FOLDER_SILENT = "folder_silent"
    CONFIGURATION_REFUSED = "configuration_refused"
    RESTART_NEEDED = "restart_needed"
    LOT_DOES_NOT_CONFORM = "lot_does_not_conform"
    LOT_DOES_NOT_CONFORM_SO_FAR = "lot_does_not_conform_so_far"
    FIGURE_DRIFTS = "figure_drifts"
    NO_STONES = "no_stones"
    BACKUP_FAILED = "backup_failed"
    NO_PROGRESS = "no_progress"
    LOOP_BLOCKED = "loop_blocked"
    CLOCK_UNSET = "clock_unset"
    CLOCK_SET = "clock_set"
    KEYS_UNREADABLE = "keys_unreadable"
    QUEUE_WAITING = "queue_waiting"
    QUEUE_TROUBLE = "queue_trouble"
    WORKERS_UP = "workers_up"
    WORKER_FAILED = "worker_failed"
    QUARANTINE = "quarantine"
    RECORDING_CUT_SHORT = "recording_cut_short"
    ARCHIVE_LEFT_OUT = "archive_left_out"
    REFINEMENT_RUSHED = "refinement_rushed"
    REFINEMENT_FALLEN = "refinement_fallen"
    LIGHT_FLICKERS = "light_flickers"
    DUSTY = "dusty"
    SPOTS = "spots"
    SATURATED = "saturated"
    NOISY = "noisy"
    BLURRED = "blurred"
    BLURRED_BY_MOTION = "blurred_by_motion"
    LIGHT_CHANGED_ALL = "light_changed_all"
    LIGHT_TILTED_ALL = "light_tilted_all"
    LIGHT_CHANGED_AND_TILTED_ALL = "light_changed_and_tilted_all"
    LIGHT_CHANGED = "light_changed"
    LIGHT_TILTED = "light_tilted"
    LIGHT_CHANGED_AND_TILTED = "light_changed_and_tilted"
    CAMERA_DARKER = "camera_darker"
    WALL_DARKER = "wall_darker"
    CAMERA_CONTRADICTS = "camera_contradicts"
    CAMERA_MISSES_TANGENTS = "camera_misses_tangents"
    CAMERA_MOVED = "camera_moved"
    CAMERA_LATE = "camera_late"
    CAMERA_EARLY = "camera_early"
    CAMERAS_CONTRADICT = "cameras_contradict"
    CAMERA_LEAVES_HULL = "camera_leaves_hull"
    BACKGROUND_MISSING = "background_missing"
    NETWORK_ALONE = "network_alone"
    SEGMENTATION_CLASSICAL = "segmentation_classical"
    NETWORK_TROUBLED = "network_troubled"
    STORE_FULL = "store_full"
    STORE_LOCKED = "store_locked"
    STORE_UNWRITABLE = "store_unwritable"
    STORE_DISK = "store_disk"
    STORE_DAMAGED = "store_damaged"
    STORE_AWAITED = "store_awaited"
    STORE_ASIDE = "store_aside"
    DISK_SILENT = "disk_silent"
    DISK_FREE = "disk_free"
    DISK_TAKEN = "disk_taken"
    DISK_SHORT = "disk_short"
    RETENTION_FAILED = "retention_failed"
    CONSUMER_OVERRUN = "consumer_overrun"
    CALIBRATION_IN_USE = "calibration_in_use"
    CALIBRATION_LIST_LOST = "calibration_list_lost"
    CALIBRATION_DAMAGED = "calibration_damaged"
    CALIBRATIONS_UNREADABLE = "calibrations_unreadable"
    VERIFICATION_FAILED = "verification_failed"
    VERIFICATION_OVERDUE = "verification_overdue"
    VERIFICATION_MISSING = "verification_missing"
    CALIBRATION_OPEN = "calibration_open"
    CALIBRATION_PROBLEM = "calibration_problem"
    CALIBRATION_IDLE = "calibration_idle"
    CALIBRATION_CHANGED = "calibration_changed"
    CALIBRATION_NOT_COMPUTED = "calibration_not_computed"
    CALIBRATION_NOT_WRITTEN = "calibration_not_written"
    DIAMETER_OFF = "diameter_off"
    DIAMETER_SCATTERS = "diameter_scatters"
    DIAMETERS_DIFFER = "diameters_differ"
    BALL_OF_OTHER_SIZE = "ball_of_other_size"
    BALLS_MISSING = "balls_missing"
    CANCELLED_ON_REQUEST = "cancelled_on_request"
    DAEMON_RESTARTED = "daemon_restarted"
    VERDICT_VOID = "verdict_void"
    VERIFICATION_OPEN = "verification_open"
    STUDY_SMALL_LOT = "study_small_lot"
    STUDY_FEW_LOTS = "study_few_lots"
    STUDY_UNCHECKED = "study_unchecked"
    STUDY_WORSE = "study_worse"
    COLUMN_APERTURE = "column_aperture"
    COLUMN_RETAINED = "column_retained"
    COLUMN_CUMULATIVE = "column_cumulative"
    COLUMN_PASSING = "column_passing"
    COLUMN_LOT = "column_lot"
    DECIMAL_POINT = "decimal_point"
    DECIMAL_COMMA = "decimal_comma"
    RETAINED_BY_APERTURE = "retained_by_aperture"
    SIEVING_CONTRADICTS = "sieving_contradicts"
    SIEVING_TOP_HEAVY = "sieving_top_heavy"


@served
class CodedFinding:
    """Part of a message: what it says, of what, and how much."""

    code: Code
    """What is said, one word"""
    subjects: tuple[str, ...] = ()
    """Names of what is concerned, from the whole to the part: a check, cameras, a lot, an endpoint"""
    parameters: Mapping[str, Value]
    """Figures, whose names end with the unit, ids, and texts that others have made"""


class CodedText(str):
    """A text in English, with the findings that it is made of."""

    findings: tuple[CodedFinding, ...]

    def __new__(cls, text: str, findings: Iterable[CodedFinding]) -> "CodedText":
        """Return the text; `findings` are what it says."""
        made = super().__new__(cls, text)
        made.findings = tuple(findings)
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return CodedText, (str(self), self.findings)


def _kept(value: Any, validate: Any) -> str:
    return value if isinstance(value, CodedText | Told) else validate(value)


Said = Annotated[str, WrapValidator(_kept)]
"""A text of a model that stays a `CodedText`, or the fault of a driver, if it is one."""


NAMES = ("figure", "problem", "rules")
"""Parameters that are names, or several with commas, and have words themselves."""


def message(code: Code, **parameters: Value) -> CodedText:
    """Return the message of one code; raise `KeyError` if its words need a parameter that is missing."""
    return CodedText(
        worded(f"message.{code}", Language.ENGLISH, parameters),
        [CodedFinding(code=code, parameters=parameters)],
    )


def about(subject: str, said: str) -> CodedText:
    """Return a message with its subject before it, as in `c05: outlines are 13.0 px wide`."""
    found = (replace(each, subjects=(subject, *each.subjects)) for each in findings_of(said))
    return CodedText(f"{subject}: {said}", found)


def joined(messages: Collection[str], between: str = "; ") -> CodedText | None:
    """Return several messages as one, None if there is none."""
    if not messages:
        return None
    return CodedText(between.join(messages), [found for each in messages for found in findings_of(each)])


def findings_of(said: str | None) -> tuple[CodedFinding, ...]:
    """Return the findings of a text; one without codes is as another program or a device reported it."""
    if said is None:
        return ()
    if isinstance(said, CodedText):
        return said.findings
    if isinstance(said, Told):
        return (CodedFinding(code=Code(said.fault), parameters=said.parameters),)
    return (CodedFinding(code=Code.REPORTED, parameters={"reported": said}),)


@cache
def message_words(language: Language) -> Mapping[str, str]:
    """Return the words of messages, `message.` and the code, of their subjects, `subject.` and its name, and of names.

    `name.` and the name are what a parameter of `NAMES` may say; `#` in it is a sieve's size.
    The English ones of a device's fault are those of its driver.
    """
    document = tomllib.loads((FOLDER / "messages.toml").read_text(encoding="utf-8"))
    faults: dict[str, dict[str, str]] = {fault: {Language.ENGLISH: fault.words} for fault in DeviceFault}
    messages = document | {name: words | document[name] for name, words in faults.items()}
    kinds = {"subject": messages.pop("subjects"), "name": messages.pop("names"), "message": messages}
    return {f"{kind}.{name}": each[language] for kind, words in kinds.items() for name, each in words.items()}


def in_language(findings: Iterable[CodedFinding], language: Language) -> str:
    """Return findings as one text of a language."""

    def text(found: CodedFinding) -> str:
        subjects = (subject_words(each, language) for each in found.subjects)
        return ": ".join([*subjects, worded(f"message.{found.code}", language, found.parameters)])

    return "; ".join(map(text, findings))


def worded(key: str, language: Language, values: Mapping[str, Value]) -> str:
    """Return words with their values: `{name}`, or `{name:.1f}`, `{name:+.1f}` and `{name:g}` with digits and sign."""

    def shown(match: re.Match[str]) -> str:
        name, form = match.groups()
        value = values[name]
        if name in NAMES:
            return ", ".join(_named(each, language) for each in str(value).split(", "))
        if not form:
            return str(value)
        text = format(value, form)
        return text.replace(".", ",") if language is Language.GERMAN else text

    return re.sub(r"\{(\w+)(?::(\+?\.\df|g))?\}", shown, message_words(language)[key])


def _named(name: str, language: Language) -> str:
    size = "".join(re.findall(r"^passing_([\d.]+)_mm_percent$", name))
    word = message_words(language).get(f"name.{name.replace(size, '#', 1) if size else name}", name)
    return word.replace("#", size.replace(".", ",") if language is Language.GERMAN else size)


def subject_words(subject: str, language: Language) -> str:
    """Return the words of a finding's subject, such as a check; an id as it is."""
    kind, _, name = subject.partition(":")
    word = message_words(language).get(f"subject.{kind}")
    return subject if word is None else f"{word} {name}".strip()
