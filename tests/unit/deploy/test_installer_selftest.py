"""The self-test of an installation tells a wrong figure from a right one."""

import json
from collections.abc import Mapping
from pathlib import Path

import pytest
from installer import selftest
from installer.selftest import Reference

TRUE = [{"bundle": "1-sphere", "outcome": "measured", "volume_mm3": 1767.1, "sieve_size_mm": 15.0}]


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({}, None),
        ({"volume_mm3": 1768.0}, None),
        ({"volume_mm3": 1770.0}, "volume_mm3 is 1770.000, but 1767.100 by the host that made"),
        ({"sieve_size_mm": 15.3}, "15.000 by the body's true shape"),
        ({"sieve_size_mm": float("nan")}, "sieve_size_mm is nan"),
        ({"outcome": "rejected"}, "1-sphere: rejected, not measured"),
        ({"bundle": "another"}, "1-sphere: no result, not measured"),
    ],
)
def test_the_self_test_can_fail(change: Mapping[str, object], found: str | None) -> None:
    expected = [each for reference in Reference for each in selftest.expectations(TRUE, reference)]
    problems = selftest.deviations(expected, [{**TRUE[0], **change}])
    assert problems == [] if found is None else found in "; ".join(problems)


@pytest.mark.parametrize(("share", "agrees"), [(1.0, True), (1.005, False)])
def test_the_recording_of_another_bundle_brings_its_figures(
    tmp_path: Path, share: float, agrees: bool
) -> None:
    truth, measured = tmp_path / selftest.TRUTH, tmp_path / "measured"
    truth.parent.mkdir(parents=True)
    measured.mkdir()
    truth.write_text(json.dumps({**TRUE[0], "kind": "particle"}) + "\n")
    results = measured / selftest.RESULTS
    results.write_text(json.dumps({**TRUE[0], "outcome": "measured"}) + "\n")
    selftest.main(tmp_path, measured)
    known = (tmp_path / selftest.EXPECTED).read_bytes()
    changed = {**TRUE[0], "outcome": "measured", "volume_mm3": share * TRUE[0]["volume_mm3"]}
    results.write_text(json.dumps(changed) + "\n")
    if agrees:
        selftest.main(tmp_path, measured)
    else:
        with pytest.raises(SystemExit, match="another has measured other figures"):
            selftest.main(tmp_path, measured)
    assert (tmp_path / selftest.EXPECTED).read_bytes() == known
