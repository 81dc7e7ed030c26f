"""The tables of the standards, and what a site's own may have wrong."""

import shutil
from pathlib import Path

import pytest

from pipeline.gradation.estimates import Errors, estimate
from pipeline.gradation.indices import EN_933_3
from pipeline.gradation.specification import Range, Verdict, judge_figures, specification_of
from service.base.errors import StandardsError
from service.lots.standards import FOLDER, SIEVES, SPECIFICATIONS, read_standards


def test_all_tables_are_there_and_name_their_source() -> None:
    found = read_standards()
    assert set(found.sieve_sets) >= {"en-basic", "en-basic-1", "en-basic-2", "r20", "astm-c136", "jtg-3432"}
    assert set(found.sizes) == {f"astm-{number}" for number in (57, 67, 7, 8, 6, 5, 56, 467)}
    assert found.sizes["astm-57"].passing[12.5] == Range(25, 60)
    assert found.flakiness["FI15"].max_percent == found.shape["SI15"].max_percent == 15
    assert found.flakiness_fractions["en-933-3"] == EN_933_3
    assert found.least_portions["en-933-1"].least_kg(16.0) == pytest.approx(2.6)
    for sieves in found.sieve_sets.values():
        assert "general" in sieves.source or "found" in sieves.source or sieves.name == "stonefall"
    assert all(category.is_general for category in found.categories.values())
    assert [name for name, size in found.sizes.items() if not size.is_general] == ["astm-57"]


@pytest.mark.parametrize("name", [*read_standards().categories, *read_standards().sizes])
def test_ideal_material_conforms_once_it_is_known_well(name: str) -> None:
    """All stones between d and D; of sizes in several steps, each in the middle of its limits."""
    found = read_standards()
    if name in found.categories:
        apertures_mm = found.sieve_sets["r20"].apertures_mm
        specification = specification_of(found.categories[name], 8.0, 31.5, apertures_mm)
        percents = {sieve_mm: 100.0 if sieve_mm >= 31.5 else 0.0 for sieve_mm in specification.passing}
    else:
        specification = found.sizes[name]
        percents = {
            sieve_mm: (limits.min_percent + limits.max_percent) / 2
            for sieve_mm, limits in specification.passing.items()
        }
    passing = {
        sieve_mm: estimate(
            percent, (max(percent - 0.1, 0), min(percent + 0.1, 100)), Errors(0.05, 0.0, 0.0), 100_000, 1e5
        )
        for sieve_mm, percent in percents.items()
    }
    judgement = judge_figures(specification, passing)
    assert (judgement.verdict, judgement.is_partial) == (Verdict.CONFORMS, False)


def test_a_category_of_a_product_is_on_its_sieves() -> None:
    found = read_standards()
    of = specification_of(found.categories["GC90-10"], 8.0, 16.0, found.sieve_sets["r20"].apertures_mm)
    assert {sieve: (limit.min_percent, limit.max_percent) for sieve, limit in of.passing.items()} == {
        31.5: (100, 100),
        22.4: (100, 100),
        16.0: (90, 99),
        8.0: (0, 10),
        4.0: (0, 2),
    }


@pytest.mark.parametrize(
    ("file", "old", "new", "problem"),
    [
        (
            SIEVES,
            "apertures_mm = [1.0, 2.0, 4.0, 8.0",
            "apertures_mm = [1.0, 2.0, 8.0, 4.0",
            "'en-basic'.*rise",
        ),
        (
            SIEVES,
            "apertures_mm = [1.0",
            "apertures_mm = [-1.0",
            r"sieves\.toml: sets\.en-basic\.apertures_mm",
        ),
        (SIEVES, '"16" = 2.6', '"16" = "much"', r"sieves\.toml: least_portions\.en-933-1\.kg\.16"),
        (SIEVES, "[sets.r20]", "[sets.r20", r"sieves\.toml"),
        (SPECIFICATIONS, "[25, 60]", "[60, 25]", r"specifications\.toml: sizes\.astm-57.*limits must rise"),
        (SPECIFICATIONS, "[25, 60]", "25", r"sizes\.astm-57.*\[least, greatest\]"),
        (SPECIFICATIONS, '"12.5" = [25', '"wide" = [25', r"sizes\.astm-57\.passing\.wide"),
        (SPECIFICATIONS, "passing = ", "pasing = ", r"sizes\.astm-57\.passing: Field required"),
        (SPECIFICATIONS, "FI10 = 10", "FI10 = 110", "limits must rise"),
    ],
)
def test_a_wrong_table_is_named(tmp_path: Path, file: str, old: str, new: str, problem: str) -> None:
    folder = shutil.copytree(FOLDER, tmp_path / "standards")
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1))
    with pytest.raises(StandardsError, match=problem):
        read_standards(folder)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(StandardsError, match=r"sieves\.toml"):
        read_standards(tmp_path)
