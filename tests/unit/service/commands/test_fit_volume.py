"""`stonefall fit-volume`: fits, writes a file that the configuration reads, and names every fault."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from pipeline.measuring.volume_correction import SYNTHETIC, VolumeModel
from service.base.errors import VolumeModelError
from service.commands.cli import build_app
from service.configuration.volume_models import MeasuringSettings, read_volume_model, write_volume_model

APP = build_app(["fit-volume"])
DENSITY_G_CM3 = 2.7


def write_stones(folder: Path, gap_share: float, hidden_share: float, n: int = 12) -> tuple[Path, Path]:
    """Write results of stones, and their masses to the milligram."""
    rng = np.random.default_rng(5)
    lines, masses = [], ["bundle,mass_g"]
    for number in range(n):
        hull_mm3, gap = rng.uniform(300, 5000), rng.uniform(0.01, 0.08)
        record = {
            "bundle": f"{number:06d}-particle",
            "outcome": "measured",
            "volume_raw_mm3": hull_mm3,
            "volume_estimate_mm3": hull_mm3 * np.exp(-gap),
        }
        lines.append(json.dumps(record))
        mass_g = DENSITY_G_CM3 * hull_mm3 * np.exp(-gap_share * gap - hidden_share) / 1000
        masses.append(f"{number:06d}-particle,{mass_g:.3f}")
    lines.append(json.dumps({"bundle": "lost", "outcome": "lost"}))
    (folder / "results.jsonl").write_text("\n".join(lines) + "\n")
    (folder / "weighed.csv").write_text("\n".join(masses) + "\n")
    return folder / "results.jsonl", folder / "weighed.csv"


def fit(results: Path, weighed: Path, out: Path) -> object:
    arguments = [
        str(results),
        str(weighed),
        "--density-g-cm3",
        str(DENSITY_G_CM3),
        "--out",
        str(out),
        "--json",
    ]
    outcome = CliRunner().invoke(APP, ["fit-volume", *arguments])
    if isinstance(outcome.exception, VolumeModelError):
        raise outcome.exception
    assert outcome.exit_code == 0, outcome.output
    return json.loads(outcome.output)


def test_weighed_stones_give_their_quarry_s_coefficients(tmp_path: Path) -> None:
    results, weighed = write_stones(tmp_path, gap_share=0.9, hidden_share=0.03)
    found = fit(results, weighed, tmp_path / "basalt.json")
    assert found == pytest.approx(
        {
            "id": "basalt",
            "gap_share": 0.9,
            "hidden_share": 0.03,
            "n_stones": 12,
            "density_kg_m3": 2700.0,
            "rms_percent": 0.02,
        },
        abs=0.02,
    )
    model = MeasuringSettings(volume_model=tmp_path / "basalt.json").parameters.volume_model
    assert model.id == "basalt"
    assert model.volume_mm3(1000.0, 950.0) == pytest.approx(
        1000 * np.exp(0.9 * np.log(0.95) - 0.03), rel=2e-3
    )


def test_without_a_file_the_built_in_model_is_used() -> None:
    assert MeasuringSettings().parameters.volume_model is SYNTHETIC
    with pytest.raises(ValueError, match="density_kg_m3"):
        MeasuringSettings(density_kg_m3=27.0)


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("000012-particle,heavy", "weighed.csv: line 14: column 2: 'heavy' is not a number"),
        ("000012-particle,-1", "line 14: column 2: '-1' is not a number"),
        ("000012-particle,0", "000012-particle has the mass 0"),
        ("000012-particle", "line 14: 000012-particle has no mass"),
        ("000012-particle,1 2 3", "'1 2 3' is not a number"),
        (
            "000012-particle,2500",
            "'2500' is far from the 2.5[0-9]? g of the measured volume: look at the unit",
        ),
        ("000012-particle,2.6 mm", "is in mm, but the column in g"),
        ("000000-particle,2.5", "000000-particle is there twice"),
        ("another,2.5", "line 14: .*has no measured bundle 'another'"),
        ("lost,2.5", "has no measured bundle 'lost'"),
        (",2.5", "has no measured bundle"),
    ],
)
def test_wrong_lines_of_the_scale_are_named(tmp_path: Path, line: str, named: str) -> None:
    results, weighed = write_stones(tmp_path, 1.0, 0.0)
    of_2_5_g = {"volume_raw_mm3": 950.0, "volume_estimate_mm3": 930.0}
    another = json.dumps({"bundle": "000012-particle", "outcome": "measured", **of_2_5_g})
    results.write_text(f"{results.read_text()}{another}\n")
    weighed.write_text(weighed.read_text() + line + "\n")
    with pytest.raises(VolumeModelError, match=named):
        fit(results, weighed, tmp_path / "out.json")
    assert not (tmp_path / "out.json").exists()


def test_results_without_an_end_are_refused(tmp_path: Path) -> None:
    _, weighed = write_stones(tmp_path, 1.0, 0.0)
    with pytest.raises(VolumeModelError, match="/dev/zero: cannot be read: has more than"):
        fit(Path("/dev/zero"), weighed, tmp_path / "out.json")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("no json", "results.jsonl: line 1"),
        ("[1]", "results.jsonl: line 1"),
        (
            '{"bundle": "a", "outcome": "measured"}',
            "line 1: has no volume_raw_mm3; measure the recording again",
        ),
        (
            '{"bundle": ["a"], "outcome": "measured", "volume_raw_mm3": 9, "volume_estimate_mm3": null}',
            "line 1: has no volume_estimate_mm3",
        ),
    ],
)
def test_wrong_results_are_named(tmp_path: Path, text: str, named: str) -> None:
    results, weighed = write_stones(tmp_path, 1.0, 0.0)
    results.write_text(text + "\n")
    with pytest.raises(VolumeModelError, match=named):
        fit(results, weighed, tmp_path / "out.json")


@pytest.mark.parametrize(
    ("head", "row", "encoding"),
    [
        ("bundle;mass_g", "{};{:,}", "utf-8"),  # as a German spreadsheet saves it
        ("Bundle, Mass_g", "{}, {:.}", "utf-8-sig"),
        ("sep=,\nbundle,mass_g", "{},{:.}", "utf-8"),
        ("Masse [kg]\tGröße\tBündel", "{1:kg}\t7\t{0}", "utf-16"),
        ("Gewicht;Bündel;Bemerkung, lang", '{1:,} g;{0};"naß; und\nlang"', "cp1252"),
    ],
)
def test_any_spreadsheet_s_file_gives_the_same(tmp_path: Path, head: str, row: str, encoding: str) -> None:
    results, weighed = write_stones(tmp_path, 0.9, 0.03)
    expected = fit(results, weighed, tmp_path / "out.json")

    class Grams(float):
        def __format__(self, form: str) -> str:
            return f"{self / 1000:.6f}" if form == "kg" else f"{float(self):.3f}".replace(".", form)

    lines = [line.split(",") for line in weighed.read_text().splitlines()[1:]]
    rows = [row.format(bundle, Grams(mass_g)) for bundle, mass_g in lines]
    mark = next(mark for mark in "\t;," if mark in row)
    weighed.write_bytes(
        "\n".join(["", head, *rows, mark, f" {mark}{mark}", ""]).lstrip("\n").encode(encoding)
    )
    assert fit(results, weighed, tmp_path / "out.json") == expected


def test_masses_in_another_unit_than_the_head_s_are_refused(tmp_path: Path) -> None:
    results, weighed = write_stones(tmp_path, 0.9, 0.03)
    head, *lines = weighed.read_text().splitlines()
    in_kg = [
        f"{bundle},{float(mass_g) / 1000:.6f}"
        for bundle, _, mass_g in (line.partition(",") for line in lines)
    ]
    weighed.write_text("\n".join([head, *in_kg]))
    with pytest.raises(VolumeModelError, match=r"line 2: column 2: .* is far from the .* look at the unit"):
        fit(results, weighed, tmp_path / "out.json")
    weighed.write_text("\n".join(["bundle,mass kg", *in_kg]))
    assert fit(results, weighed, tmp_path / "out.json")


def test_too_few_stones_and_missing_columns_are_refused(tmp_path: Path) -> None:
    results, weighed = write_stones(tmp_path, 1.0, 0.0, n=4)
    with pytest.raises(VolumeModelError, match="4 bodies of known volume are too few"):
        fit(results, weighed, tmp_path / "out.json")
    weighed.write_text("bundle,mass_g\n")
    with pytest.raises(VolumeModelError, match="0 bodies"):
        fit(results, weighed, tmp_path / "out.json")
    weighed.write_text("stone;mass\n")
    with pytest.raises(VolumeModelError, match="columns bundle and mass_g"):
        fit(results, weighed, tmp_path / "out.json")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"format": "stonefall-volume/9"}, "format"),
        ({"gap_share": "much"}, "gap_share: must be a number"),
        ({"gap_share": 7}, "gap_share must be in 0..3"),
        ({"gap_share": 10**400}, "gap_share must be in 0..3"),
        ({"hidden_share": None}, "hidden_share: must be a number"),
        ({"id": 7}, "id: must be a text"),
    ],
)
def test_a_damaged_file_is_named(tmp_path: Path, change: dict[str, object], named: str) -> None:
    path = tmp_path / "model.json"
    write_volume_model(path, VolumeModel(id="m", gap_share=1.0, hidden_share=0.01), {"n_stones": 9})
    assert read_volume_model(path) == VolumeModel(id="m", gap_share=1.0, hidden_share=0.01)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(VolumeModelError, match=named):
        read_volume_model(path)
    with pytest.raises(VolumeModelError, match=r"none\.json: No such file"):
        read_volume_model(tmp_path / "none.json")
