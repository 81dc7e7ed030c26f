"""`alarms.toml`: each check is an alarm with an action, or listed as none with the reason."""

import pytest

from service.base.language import Language
from service.health.alarms.rules import Rule, load_rules

RULES = load_rules()


def test_every_check_of_health_is_an_alarm_or_says_why_not():
    assert RULES.by_check.keys() | RULES.no_alarm.keys() == set(RULES.checks)
    assert not RULES.by_check.keys() & RULES.no_alarm.keys()
    assert all(len(reason) > 20 for reason in RULES.no_alarm.values())
    assert RULES.of("camera:c07") is RULES.by_check["camera"]
    assert RULES.of("archive") is None


@pytest.mark.parametrize("rule", RULES.by_check.values(), ids=RULES.by_check)
def test_every_alarm_says_cause_and_action_in_each_language(rule: Rule):
    assert rule.warn or rule.fail
    for words in (rule.cause, rule.action):
        assert set(words) == set(Language)
        assert len(set(words.values())) == len(Language)
        assert all(text.endswith(".") for text in words.values())
    assert rule.on_delay_s >= 0
    assert rule.off_delay_s > 0


def test_parents_are_checks_and_nothing_is_its_own_ancestor():
    for name, rule in RULES.by_check.items():
        above, ancestors = list(rule.parents), set()
        while above:
            parent = above.pop()
            assert parent in RULES.by_check
            ancestors.add(parent)
            above += RULES.by_check[parent].parents
        assert name not in ancestors
