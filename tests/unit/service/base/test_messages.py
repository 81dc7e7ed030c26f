"""Messages: every code is worded in every language, and a text keeps its codes on every way it takes."""

import pickle
import re

import pytest

from drivers.errors import DeviceFault, told
from pipeline.errors import ProblemCode
from pipeline.gradation.control_chart import RuleName
from service.base.language import Language
from service.base.messages import (
    Code,
    CodedFinding,
    about,
    findings_of,
    in_language,
    joined,
    message,
    message_words,
)
from service.base.status import AcquisitionState, AcquisitionStatus, HealthCheck, trouble_check
from service.health.alarms.rules import load_rules
from service.lots.figures import SHARES

PLACE = re.compile(r"\{(\w+)(?::(?:\+?\.\df|g))?\}")


def test_every_code_has_words_in_every_language_and_no_words_are_left_over() -> None:
    for language in Language:
        words = {name for name in message_words(language) if name.startswith("message.")}
        assert words == {f"message.{code}" for code in Code}


@pytest.mark.parametrize("code", Code)
def test_a_translation_has_the_parameters_of_the_english_words(code: Code) -> None:
    english, german = (set(PLACE.findall(message_words(each)[f"message.{code}"])) for each in Language)
    if code is not Code.VERIFICATION_OVERDUE:  # its English words say hours or minutes as they are greater
        assert english - german <= {"reported", "state"}
        assert german - {"problem"} <= english  # the text of a problem in English is its own
    assert (
        message_words(Language.GERMAN)[f"message.{code}"]
        != message_words(Language.ENGLISH)[f"message.{code}"]
    )


def test_a_fault_of_a_driver_is_a_finding_in_every_language() -> None:
    assert set(DeviceFault) <= set(Code)
    fault = told(DeviceFault.GATE_MUTE, silent_s=2.5).after("light gate /dev/ttyACM0: ")
    assert fault == (
        "light gate /dev/ttyACM0: has sent nothing for 2.5 s: check its cable and its power supply"
    )
    found = (CodedFinding(code=Code.GATE_MUTE, parameters={"silent_s": 2.5}),)
    assert findings_of(fault) == findings_of(pickle.loads(pickle.dumps(fault))) == found  # noqa: S301 - pickled here
    status = AcquisitionStatus(state=AcquisitionState.HELD, gate_error=fault, gate_warnings=(fault,))
    assert findings_of(status.gate_error) == findings_of(status.gate_warnings[0]) == found
    assert in_language(found, Language.ENGLISH) == str(fault).partition(": ")[2]
    assert in_language(found, Language.GERMAN) == (
        "hat seit 2,5 s nichts gesendet: Kabel und Stromversorgung prüfen"
    )


def test_every_check_can_be_named_in_every_language() -> None:
    for language in Language:
        assert {f"subject.{check}" for check in load_rules().checks} <= set(message_words(language))


def test_a_message_keeps_what_it_is_made_of_when_it_is_joined_named_sent_and_stored() -> None:
    dust = about("c07", message(Code.DUSTY, percent=14.5))
    said = joined([about("optics", dust), "unplugged"])
    assert said == "optics: c07: 14% of the light is lost in patches: clean window and lens; unplugged"
    assert said is not None
    found = (
        CodedFinding(code=Code.DUSTY, subjects=("optics", "c07"), parameters={"percent": 14.5}),
        CodedFinding(code=Code.REPORTED, parameters={"reported": "unplugged"}),
    )
    assert findings_of(said) == found
    assert findings_of(pickle.loads(pickle.dumps(said))) == found  # noqa: S301 - ours, as between processes
    assert (
        findings_of(
            AcquisitionStatus(state=AcquisitionState.HELD, trouble=said, gate_warnings=(said,)).gate_warnings[
                0
            ]
        )
        == found
    )
    check = trouble_check(said)
    assert HealthCheck.model_validate_json(check.model_dump_json()) == check


def test_german_words_have_german_figures() -> None:
    found = findings_of(about("camera:c07", message(Code.BLURRED, width_px=13.25)))
    assert (
        in_language(found, Language.GERMAN)
        == "Kamera c07: Umrisse sind 13,2 px breit: Fokus und Fenster prüfen"
    )
    found = findings_of(message(Code.RESTART_NEEDED, settings="store.keep_raw, workers.slots"))
    assert in_language(found, Language.GERMAN) == "für store.keep_raw, workers.slots ist ein Neustart nötig"


def test_figures_and_rules_that_a_message_names_have_words() -> None:
    names = [*RuleName, *ProblemCode, *SHARES, "d50_mm", "passing_#_mm_percent"]
    for language in Language:
        assert {f"name.{name}" for name in names} <= set(message_words(language))
    found = findings_of(
        message(
            Code.FIGURE_DRIFTS,
            figure="passing_31.5_mm_percent",
            value=81.25,
            centre=88.5,
            rules="beyond_limits, ewma",
        )
    )
    assert in_language(found, Language.ENGLISH) == (
        "passing 31.5 mm, %: 81.25 about 88.5 (beyond the limits, weighted mean beyond its limits)"
    )
    assert in_language(found, Language.GERMAN) == (
        "Durchgang 31,5 mm, %: 81,25 bei Mittel 88,5"
        " (jenseits der Eingriffsgrenzen, gewichtetes Mittel jenseits seiner Grenzen)"
    )
