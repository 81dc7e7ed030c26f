"""The bill of materials is a CycloneDX document of all that is shipped; the licences are with it."""

import base64
import hashlib
import json
import re
from datetime import UTC, datetime
from importlib.metadata import Distribution, distributions
from pathlib import Path

import pytest
from installer import inventory
from installer.inventory import Component

PACKAGES = """\
Package: libc6
Architecture: amd64
Version: 1:2.36-9
Description: GNU C Library
 Version: of a description, and no field
Filename: ./libc6.deb
SHA256: {0}

Package: python3-gi
Version: 3.42.2-3
Architecture: amd64
SHA256: {0}
""".format("ab" * 32)
SERIAL = r"urn:uuid:[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}"
MADE_AT = datetime(2026, 1, 2, tzinfo=UTC)


def put(folder: Path, name: str, metadata: str, licence: str | None = None) -> None:
    """Put an installed package of a name like `Some_Name-1.0` into a folder, and its wheel beside it."""
    info = folder / "site" / f"{name}.dist-info"
    (info / "licenses").mkdir(parents=True)
    package, _, version = name.partition("-")
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.4\nName: {package}\nVersion: {version}\n{metadata}\n"
    )
    record = [f"{info.name}/METADATA,,"]
    if licence is not None:
        (info / "licenses/LICENSE").write_text(licence)
        record.append(f"{info.name}/licenses/LICENSE,,")
    (info / "RECORD").write_text("\n".join(record) + "\n")
    (folder / "wheels").mkdir(exist_ok=True)
    (folder / "wheels" / f"{name}-py3-none-any.whl").write_text(name)


@pytest.fixture
def components(tmp_path: Path) -> list[Component]:
    put(tmp_path, "stonefall-0.3.0", 'Requires-Dist: Some.Name>=1\nRequires-Dist: torch; extra == "train"')
    put(tmp_path, "some_name-1.0", "License-Expression: MIT AND 0BSD\nRequires-Dist: old", "Permission")
    put(
        tmp_path,
        "old-2",
        "License: a text\n        of two lines\nClassifier: License :: OSI Approved :: BSD License",
    )
    packages = tmp_path / "packages/three"
    packages.mkdir(parents=True)
    (packages / "LICENSE").write_text("three's")
    integrity = "sha512-" + base64.b64encode(b"\1" * 64).decode()
    entry = {"version": "0.187.0", "integrity": integrity, "license": "MIT"}
    lock = {"packages": {"": {}, "node_modules/three": entry, "node_modules/axe-core": entry}}
    return [
        *inventory.wheels(installed(tmp_path), tmp_path / "wheels"),
        *inventory.npm_packages(lock, packages.parent),
        *inventory.debian_packages(PACKAGES, "12"),
    ]


def installed(folder: Path) -> list[Distribution]:
    return list(distributions(path=[str(folder / "site")]))


def test_the_document_keeps_the_rules_of_cyclonedx(components: list[Component]) -> None:
    document = inventory.sbom(components, MADE_AT)
    assert (document["bomFormat"], document["specVersion"], document["version"]) == ("CycloneDX", "1.6", 1)
    assert re.fullmatch(SERIAL, document["serialNumber"])
    assert document["metadata"]["timestamp"] == "2026-01-02T00:00:00Z"
    own = document["metadata"]["component"]
    assert (own["type"], own["name"], own["version"]) == ("application", "stonefall", "0.3.0")
    every = [own, *document["components"]]
    refs = [each["bom-ref"] for each in every]
    assert len(set(refs)) == len(refs)
    for each in every:
        assert each["type"] in {"application", "library"} and each["name"]
        for found in each["hashes"]:
            digits = {"SHA-256": 64, "SHA-512": 128}[found["alg"]]
            assert re.fullmatch(rf"[0-9a-f]{{{digits}}}", found["content"])
        for found in each.get("licenses", ()):
            assert set(found) in ({"expression"}, {"license"})
    for each in document["dependencies"]:
        assert {each["ref"], *each["dependsOn"]} <= set(refs)
    assert inventory.sbom(components, MADE_AT) == document
    assert json.loads(json.dumps(document)) == document


def test_every_package_is_in_it_with_its_address_and_licence(components: list[Component]) -> None:
    found = {each["name"]: each for each in inventory.sbom(components, MADE_AT)["components"]}
    assert set(found) == {"some-name", "old", "three", "libc6", "python3-gi"}  # not axe-core, nor an extra
    assert found["some-name"]["licenses"] == [{"expression": "MIT AND 0BSD"}]
    assert found["some-name"]["hashes"][0]["content"] == hashlib.sha256(b"some_name-1.0").hexdigest()
    assert found["old"]["licenses"] == [{"license": {"name": "BSD License"}}]
    assert found["libc6"]["purl"] == "pkg:deb/debian/libc6@1%3A2.36-9?arch=amd64&distro=debian-12"
    assert found["three"]["purl"] == "pkg:npm/three@0.187.0"
    dependencies = {
        each["ref"]: each["dependsOn"] for each in inventory.sbom(components, MADE_AT)["dependencies"]
    }
    assert dependencies["pkg:pypi/stonefall@0.3.0"] == ["pkg:pypi/some-name@1.0"]
    text = inventory.licences(components)
    for expected in ("Permission", "of two lines", "three's", "/usr/share/doc/libc6/copyright (1:2.36-9)"):
        assert expected in text


def test_a_package_without_its_wheel_is_not_passed_over(tmp_path: Path) -> None:
    put(tmp_path, "some_name-1.0", "")
    (tmp_path / "wheels/some_name-1.0-py3-none-any.whl").unlink()
    with pytest.raises(KeyError):
        list(inventory.wheels(installed(tmp_path), tmp_path / "wheels"))
