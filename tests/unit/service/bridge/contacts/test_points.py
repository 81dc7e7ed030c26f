"""Contacts and registers: off or unknown unless it is known; the guide has the table of the code."""

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.bridge import alarm, overview

from pipeline.gradation.specification import Verdict
from service.base.status import AcquisitionState, Ne107
from service.bridge.contacts.points import (
    ACQUISITION,
    BITS,
    NE107,
    REGISTERS,
    UNKNOWN,
    VERDICTS,
    Contact,
    as_markdown,
    bits,
    registers,
)
from service.bridge.plant_state import PlantState, alarms_of, state_of

WELL = state_of(overview(), ())
ALARMED = alarms_of({"items": [alarm(3)]})


def on(state: PlantState, n_answers: int = 0) -> set[Contact]:
    return {bit.name for bit, is_on in zip(BITS, bits(state, n_answers), strict=True) if is_on}


def words(state: PlantState, n_answers: int = 0) -> dict[str, tuple[int, ...]]:
    return {register.name: register.words(state, n_answers) for register in REGISTERS}


def test_contacts_of_a_plant_where_all_is_well() -> None:
    well = {Contact.DAEMON_ANSWERS, Contact.RIG_READY, Contact.LOT_OPEN, Contact.LOT_CONFORMS}
    assert on(WELL) == well
    assert on(WELL, 1) == well | {Contact.HEARTBEAT}
    assert on(replace(WELL, verdict=Verdict.DOES_NOT_CONFORM)) == well - {Contact.LOT_CONFORMS} | {
        Contact.OUT_OF_LIMITS
    }
    assert on(replace(WELL, verdict=Verdict.UNDECIDED)) == well - {Contact.LOT_CONFORMS}
    assert on(replace(WELL, alarms=ALARMED)) == well | {Contact.ALARM, Contact.ALARM_UNACKNOWLEDGED}
    assert on(replace(WELL, is_simulated=True)) == well | {Contact.SIMULATED}


def test_a_dead_daemon_has_every_contact_off_and_every_figure_unknown() -> None:
    assert on(PlantState(), 1) == set()
    known = {name: value for name, value in words(PlantState(), 5).items() if set(value) - {0, UNKNOWN}}
    assert known == {"map_version": (1,), "heartbeat": (5,)}


@given(
    st.builds(
        replace,
        st.just(WELL),
        daemon_answers=st.booleans(),
        ready=st.booleans(),
        ne107=st.sampled_from([None, *Ne107]),
        verdict=st.sampled_from([None, *Verdict]),
        alarms=st.sampled_from([(), ALARMED]),
    )
)
def test_good_news_is_only_of_a_good_rig(state: PlantState) -> None:
    found = on(state, 1)
    if not (state.daemon_answers and state.ready and state.ne107 in ("good", "maintenance_required")):
        assert not found & {Contact.RIG_READY, Contact.LOT_CONFORMS, Contact.OUT_OF_LIMITS}
    assert not {Contact.LOT_CONFORMS, Contact.OUT_OF_LIMITS} <= found
    assert state.daemon_answers or not found


def test_words_of_a_plant_where_all_is_well() -> None:
    found = words(replace(WELL, alarms=ALARMED), 65_537)
    assert found["lot"] == (0x4C2D, 0x3700, *(0,) * 30)  # "L-7"
    assert {name: value for name, value in found.items() if name != "lot"} == {
        "map_version": (1,),
        "heartbeat": (1,),
        "ne107": (1,),
        "acquisition": (3,),
        "verdict": (3,),
        "last_verdict": (3,),
        "alarms": (1,),
        "stones_per_min": (240,),
        "d50": (1123,),
        "flakiness": (80,),
        "shape": (UNKNOWN,),  # not measured, which is not 0
        "lot_stones": (1, 4464),
        "measured": (1, 33_464),
        "rejected": (0, 900),
        "lost": (0, 99),
        "last_seq": (1, 34_463),
    }


@given(st.integers(0, 10**12), st.integers(0, 10**9))
def test_words_are_words_whatever_is_counted(n: int, n_answers: int) -> None:
    found = registers(replace(WELL, n_stones=n, stones_per_min=n, last_seq=n, lot="Ä" * 200), n_answers)
    assert len(found) == sum(register.n_words for register in REGISTERS)
    assert all(0 <= word <= 0xFFFF for word in found)


def test_every_word_of_a_code_has_a_number() -> None:
    assert set(NE107) == {None, *Ne107}
    assert set(ACQUISITION) == {None, *AcquisitionState}
    assert set(VERDICTS) == {None, *Verdict}


def test_the_guide_has_the_table() -> None:
    guide = (Path(__file__).parents[5] / "service/bridge/README.md").read_text(encoding="utf-8")
    assert as_markdown() in guide


@pytest.mark.parametrize("name", ["heartbeat", "rig_ready", "lot_conforms", "out_of_limits"])
def test_names_that_controllers_use_stay(name: str) -> None:
    assert [bit.name for bit in BITS].index(Contact(name)) == {
        "heartbeat": 0,
        "rig_ready": 2,
        "lot_conforms": 4,
        "out_of_limits": 5,
    }[name]
