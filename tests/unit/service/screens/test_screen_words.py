"""The words of the pages: both languages have the same, and scripts and pages use all of them and no others."""

import json
import re
from pathlib import Path

import pytest

from pipeline.errors import RejectReason
from pipeline.gradation.specification import Verdict
from pipeline.segmentation.silhouette import ViewStatus
from service import screens
from service.base.language import Language, figure_names
from service.base.messages import message_words
from service.base.status import AcquisitionState, DeviceState, Ne107
from service.calibration.states import CalibrationState
from service.calibration.verifications import VerificationState
from service.health.alarms.alarm import ANNOUNCED
from service.health.alarms.rules import Priority
from service.lots.stone_changes import FORM_FACTORS
from service.recording.live_recording import EndedBy, RecordingState
from service.reports.signatures import SignatureState
from service.results.fields import MEASURED_FIELDS, LossReason, Outcome, Verified
from service.web.auth import ANYBODY, THIS_MACHINE
from service.web.problems import all_problems
from service.web.routes.screens import installed_screens

FOLDER = Path(screens.__file__).parent
WORDS = {
    language: json.loads((FOLDER / f"words/{language}.json").read_text(encoding="utf-8"))
    for language in Language
}
PREFIXES = "|".join(sorted({key.partition(".")[0] for key in WORDS[Language.ENGLISH]}))
LITERAL = re.compile(rf"""["'`]((?:{PREFIXES})\.[^"'`\s]+)["'`]""")
PLACE = re.compile(r"\{(\w+)\}")


def used() -> dict[str, list[str]]:
    """The keys that scripts and pages name, each with where; what is put into a key is `${...}`."""
    shown = installed_screens()
    scripts = {path: file for path, file in shown.files.items() if path.startswith("scripts/")}
    found: dict[str, list[str]] = {}
    texts = {path: file.content.decode() for path, file in scripts.items()}
    for path, text in {**texts, **shown.pages}.items():
        for key in LITERAL.findall(text):
            found.setdefault(key, []).append(path)
    return found


def pattern(key: str) -> re.Pattern[str]:
    fixed = re.split(r"\$\{[^}]*\}", key)
    return re.compile("[A-Za-z0-9_-]+".join(map(re.escape, fixed)))


def test_both_languages_have_the_same_words_in_order() -> None:
    english, german = WORDS[Language.ENGLISH], WORDS[Language.GERMAN]
    assert list(english) == list(german) == sorted(english)
    for key, text in english.items():
        assert text.strip() and german[key].strip(), key
        assert sorted(PLACE.findall(text)) == sorted(PLACE.findall(german[key])), key


def test_every_key_that_is_used_has_words() -> None:
    for key, paths in used().items():
        assert any(pattern(key).fullmatch(each) for each in WORDS[Language.ENGLISH]), (key, paths)


def test_no_word_is_left_over() -> None:
    patterns = [pattern(key) for key in used()]
    assert patterns
    unused = [key for key in WORDS[Language.ENGLISH] if not any(each.fullmatch(key) for each in patterns)]
    assert unused == []


def test_all_measures_of_the_form_have_names_and_all_names_are_of_measures() -> None:
    english, german = (figure_names(language) for language in (Language.ENGLISH, Language.GERMAN))
    assert list(english) == list(german)
    named = {key.removeprefix("measure.") for key in english if key.startswith("measure.")}
    assert {*FORM_FACTORS, "zingg_class"} <= named <= {*MEASURED_FIELDS, "length_to_thickness"}


@pytest.mark.parametrize(
    ("prefix", "values"),
    [
        ("ne107.", list(Ne107)),
        ("operator.state-", [state for state in AcquisitionState if state is not AcquisitionState.ARMED]),
        ("operator.activity-", ["idle", "measuring", "suspended"]),
        ("verdict.", [*Verdict, "none"]),
        (
            "operator.sentence-",
            [*Verdict, "none", "conforms-partly", "closed-undecided", "closed-does_not_conform"],
        ),
        ("who.", [THIS_MACHINE.replace(" ", "-"), ANYBODY]),
        ("operator.priority-", list(Priority)),
        ("operator.alarm-", list(ANNOUNCED)),
        ("operator.camera-", list(DeviceState)),
        ("operator.verification-", list(Verified)),
        ("operator.outcome-", [Outcome.REJECTED, Outcome.LOST]),
        ("operator.reason-", [*RejectReason, *LossReason]),
        ("operator.form-", ["equant", "disc", "rod", "blade"]),
        ("operator.quality-", ["reduced", "degraded"]),
        ("setup.refused-", [status for status in ViewStatus if status is not ViewStatus.OK]),
        ("setup.calibration-state-", list(CalibrationState)),
        ("setup.verification-state-", list(VerificationState)),
        ("setup.recording-state-", list(RecordingState)),
        ("setup.recording-ended-", list(EndedBy)),
        ("verify.state-", list(SignatureState)),
        ("problem.", [slug for titles in all_problems().values() for slug in titles]),
    ],
)
def test_every_value_that_is_told_has_words(prefix: str, values: list[str]) -> None:
    assert [value for value in values if f"{prefix}{value}" not in WORDS[Language.ENGLISH]] == []


@pytest.mark.parametrize("language", Language)
def test_all_long_words_can_be_broken(language: Language) -> None:
    told = {**WORDS[language], **figure_names(language), **message_words(language)}
    parts = told.pop("header.breaks").split()
    stems = [each.replace("-", "") for each in parts]
    assert len(set(stems)) == len(stems)
    words = {each for text in told.values() for each in re.findall(r"[^\W\d_]{15,}", text)}
    assert [each for each in sorted(words) if not any(stem in each for stem in stems)] == []
    assert [stem for stem in stems if not any(stem in text for text in told.values())] == []
