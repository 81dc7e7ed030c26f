"""The scripts of rehearsals as data."""

import inspect

import pytest

from service.commands.rehearsal.day import DEEDS, Day, Script, scripts
from service.health.alarms.rules import load_rules

ALL = list(scripts().values())


@pytest.mark.parametrize("script", ALL, ids=lambda script: script.name)
def test_every_step_is_a_deed_with_its_arguments(script: Script) -> None:
    for step in script.steps:
        assert step.do in DEEDS
        inspect.signature(getattr(Day, step.do)).bind(None, **step.arguments)


@pytest.mark.parametrize("script", ALL, ids=lambda script: script.name)
def test_the_alarms_of_a_script_are_those_that_it_waits_for(script: Script) -> None:
    waited_for = [step.arguments["check"] for step in script.steps if step.do == "alarm"]
    assert waited_for == list(script.alarms)
    for check in script.alarms:
        assert load_rules().of(check) is not None
