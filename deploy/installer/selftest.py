"""The self-test: figures that this host measures on the bundle's recording, against known ones.

`expected.json` is written when the bundle is made, and only if the figures measured then agree with the true shapes of
the rendered bodies. The host that is installed must agree with both.
"""

import json
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

EXPECTED, RESULTS, TRUTH = "expected.json", "results.jsonl", "recording/truth.jsonl"


class Reference(StrEnum):
    """Origin of an expected value."""

    TRUTH = "the body's true shape"
    BUILDER = "the host that made the bundle"


TOLERANCES: Mapping[Reference, Mapping[str, tuple[float, float]]] = {
    Reference.TRUTH: {"volume_mm3": (0.02, 0.0), "sieve_size_mm": (0.0, 0.15)},
    Reference.BUILDER: {"volume_mm3": (0.001, 0.0), "sieve_size_mm": (0.0, 0.01)},
}
"""Largest deviation of each figure: a share of the value, and an absolute part."""


@dataclass(frozen=True)
class Expectation:
    """One figure of one body, and the tolerance of its measurement."""

    bundle: str
    figure: str
    value: float
    tolerance: float
    reference: Reference


def expectations(records: Iterable[Mapping[str, Any]], reference: Reference) -> list[Expectation]:
    """Return the expected value and tolerance of each figure, by true shapes or by results of a measurement."""
    return [
        Expectation(
            record["bundle"],
            figure,
            record[figure],
            share * record[figure] + absolute,
            reference,
        )
        for record in records
        for figure, (share, absolute) in TOLERANCES[reference].items()
    ]


def deviations(expected: Iterable[Expectation], records: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return a sentence for every expectation that the results do not meet."""
    measured = {record["bundle"]: record for record in records}
    found = []
    for each in expected:
        record = measured.get(each.bundle, {})
        if record.get("outcome") != "measured":
            found.append(f"{each.bundle}: {record.get('outcome', 'no result')}, not measured")
        elif not abs(record[each.figure] - each.value) <= each.tolerance:
            found.append(
                f"{each.bundle}: {each.figure} is {record[each.figure]:.3f}, but {each.value:.3f} by {each.reference}"
                f" (tolerance {each.tolerance:.3f})"
            )
    return list(dict.fromkeys(found))


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Return the JSON objects of a file with one in each line."""
    return [json.loads(line) for line in path.read_text().splitlines()]


def read_expectations(selftest: Path) -> list[Expectation]:
    """Return the expectations of a bundle."""
    return [
        Expectation(**{**entry, "reference": Reference(entry["reference"])})
        for entry in json.loads((selftest / EXPECTED).read_text())
    ]


def main(selftest: Path, measured: Path) -> None:
    """Write `expected.json`; exit with what is wrong if the figures are not the true ones or the known ones."""
    records = read_lines(measured / RESULTS)
    if (selftest / EXPECTED).exists():  # of the bundle that the recording is from
        if found := deviations(read_expectations(selftest), records):
            sys.exit(f"no bundle: another has measured other figures: {'; '.join(found)}")
        return
    true = expectations(
        [each for each in read_lines(selftest / TRUTH) if each["kind"] == "particle"], Reference.TRUTH
    )
    if not true or (found := deviations(true, records)):
        sys.exit(f"no bundle: its own self-test fails: {'; '.join(found) if true else 'no body in it'}")
    every = [*true, *expectations(records, Reference.BUILDER)]
    (selftest / EXPECTED).write_text(json.dumps([asdict(each) for each in every], indent=2) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
