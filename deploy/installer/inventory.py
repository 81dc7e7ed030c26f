"""The inventory of a bundle: a software bill of materials (CycloneDX 1.6, JSON) and the licences of all in it.

`deploy/bundle` runs it in the environment that it has made: `python -m installer.inventory BUNDLE WHEELS`. Packages of
Debian are listed by the index of the bundle; each brings its licence itself, /usr/share/doc/PACKAGE/copyright.
"""

import base64
import hashlib
import json
import os
import re
import sys
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

FOLDER = Path("share/doc/stonefall")
SBOM, LICENCES = FOLDER / "sbom.cdx.json", FOLDER / "licences.txt"
SCHEMA = "http://cyclonedx.org/schema/bom-1.6.schema.json"
NAME = "stonefall"
LICENCE_FILE = re.compile(r"(?i)^(licen[cs]e|copying|notice|thirdpartynotices|copyright|authors)[^/]*$")
LONGEST_NAME = 100
"""Longest declared licence that is a name; some packages declare the whole text."""


@dataclass(frozen=True)
class Component:
    """A package that is shipped; `purl` is its address by the Package URL specification."""

    name: str
    version: str
    purl: str
    hashes: tuple[tuple[str, str], ...]  # algorithm and hexadecimal digits
    licence: str  # as declared; empty: it is in the package itself
    is_spdx: bool = False  # the licence is an SPDX expression
    texts: tuple[tuple[str, str], ...] = ()  # name and content of each licence file
    needs: tuple[str, ...] = ()  # names of others


def wheels(environment: Sequence[Distribution], folder: Path) -> Iterator[Component]:
    """Yield the Python packages of an environment, with the hashes of the wheels that they were installed from."""
    files = {_wheel_key(path.name): path for path in folder.glob("*.whl")}
    for found in sorted(environment, key=lambda found: normalized(found.name)):
        name = normalized(found.name)
        path = files[name, found.version]
        yield Component(
            name,
            found.version,
            f"pkg:pypi/{name}@{found.version}",
            (("SHA-256", hashlib.sha256(path.read_bytes()).hexdigest()),),
            declared_licence(found),
            "License-Expression" in found.metadata,
            tuple(licence_texts(found)),
            tuple(needed(found)),
        )


def debian_packages(index: str, debian: str) -> Iterator[Component]:
    """Yield the packages of Debian that an index (a file `Packages`) lists."""
    for stanza in index.strip().split("\n\n"):
        fields = dict(re.findall(r"^([A-Za-z0-9-]+): (.*)$", stanza, re.MULTILINE))
        name, version = fields["Package"], fields["Version"]
        where = f"arch={fields['Architecture']}&distro=debian-{debian}"
        purl = f"pkg:deb/debian/{name}@{version.replace(':', '%3A')}?{where}"
        yield Component(name, version, purl, (("SHA-256", fields["SHA256"]),), "")


def npm_packages(lock: dict[str, Any], packages: Path) -> Iterator[Component]:
    """Yield the packages of a package-lock.json that the pages take, those with a folder in `packages`."""
    for place, entry in lock["packages"].items():
        name = place.removeprefix("node_modules/")
        licence = packages / name / "LICENSE"
        if place and licence.is_file():
            digits = base64.b64decode(entry["integrity"].removeprefix("sha512-")).hex()
            version, texts = entry["version"], ((licence.name, licence.read_text()),)
            purl = f"pkg:npm/{name}@{version}"
            yield Component(name, version, purl, (("SHA-512", digits),), entry["license"], True, texts)


def normalized(name: str) -> str:
    """Return the name of a Python package as PyPI compares it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _wheel_key(name: str) -> tuple[str, str]:
    distribution, version = name.split("-")[:2]
    return normalized(distribution), version


def declared_licence(found: Distribution) -> str:
    """Return the licence that a package declares: an SPDX expression, a name, or its classifiers."""
    if expression := _field(found, "License-Expression"):
        return expression
    classifiers = [
        each.rpartition(" :: ")[2]
        for each in found.metadata.get_all("Classifier") or ()
        if each.startswith("License :: ") and each != "License :: OSI Approved"
    ]
    name = _field(found, "License")
    return name if name and "\n" not in name and len(name) <= LONGEST_NAME else ", ".join(classifiers)


def _field(found: Distribution, name: str) -> str:
    return found.metadata[name].strip() if name in found.metadata else ""


def licence_texts(found: Distribution) -> Iterator[tuple[str, str]]:
    """Yield path and text of each licence file that a package brought."""
    for path in sorted(found.files or (), key=str):
        is_text = "licenses" in path.parts[1:-1] and path.parts[0].endswith(".dist-info")
        if (is_text or LICENCE_FILE.match(path.name)) and path.suffix not in {".py", ".pyc"}:
            place = Path(str(path.locate()))
            if place.is_file():
                yield str(path), place.read_text(errors="replace")
    if "\n" in (whole := _field(found, "License")):
        yield "METADATA", whole


def needed(found: Distribution) -> Iterator[str]:
    """Yield the names of the packages that a package needs here, without its extras."""
    for line in found.requires or ():
        requirement = Requirement(line)
        if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
            yield normalized(requirement.name)


def sbom(components: Sequence[Component], made_at: datetime) -> dict[str, Any]:
    """Return the bill of materials as a CycloneDX document; equal components give equal documents.

    Source: ECMA-424 (CycloneDX 1.6).
    """
    own = next(each for each in components if each.name == NAME)
    purls = {each.name: each.purl for each in components if each.purl.startswith("pkg:pypi/")}
    document: dict[str, Any] = {
        "$schema": SCHEMA,
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "timestamp": made_at.strftime("%Y-%m-%dT%H:%M:%SZ"),
            "component": {"type": "application", **_entry(own)},
        },
        "components": [{"type": "library", **_entry(each)} for each in components if each is not own],
        "dependencies": [
            {"ref": each.purl, "dependsOn": sorted({purls[name] for name in each.needs if name in purls})}
            for each in components
        ],
    }
    content = json.dumps(document, sort_keys=True)
    return {**document, "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, content)}"}


def _entry(each: Component) -> dict[str, Any]:
    entry: dict[str, Any] = {"bom-ref": each.purl, "name": each.name, "version": each.version}
    entry["purl"] = each.purl
    entry["hashes"] = [{"alg": algorithm, "content": digits} for algorithm, digits in each.hashes]
    if each.licence:
        entry["licenses"] = [
            {"expression": each.licence} if each.is_spdx else {"license": {"name": each.licence}}
        ]
    return entry


def licences(components: Sequence[Component]) -> str:
    """Return one text with the licences of all components, those of Debian by reference."""
    debian = [each for each in components if each.purl.startswith("pkg:deb/")]
    parts = []
    for each in components:
        if each in debian:
            continue
        head = f"{each.name} {each.version}: {each.licence or 'no licence is declared'}"
        parts.append(f"{'=' * 78}\n{head}\n{'=' * 78}\n")
        parts += [f"--- {name}\n\n{text.strip()}\n" for name, text in each.texts]
    lines = [f"/usr/share/doc/{each.name}/copyright ({each.version})" for each in debian]
    parts.append(
        f"{'=' * 78}\nPackages of Debian; each brings its licence:\n{'=' * 78}\n" + "\n".join(lines) + "\n"
    )
    return "\n".join(parts)


def main(bundle: Path, folder: Path) -> None:
    """Write both files of the inventory into a bundle."""
    debian = re.search(r'^VERSION_ID="?(\d+)', Path("/etc/os-release").read_text(), re.MULTILINE)
    libraries = next(Path(each) for each in sys.path if each.endswith("site-packages"))
    environment = list(distributions(path=[str(libraries)]))
    components = [
        *wheels(environment, folder),
        *npm_packages(
            json.loads((bundle / "deploy/npm/package-lock.json").read_text()),
            libraries / "service/screens/packages",
        ),
        *debian_packages((bundle / "debs/Packages").read_text(), debian[1] if debian else ""),
    ]
    made_at = datetime.fromtimestamp(int(os.environ["SOURCE_DATE_EPOCH"]), UTC)
    (bundle / FOLDER).mkdir(parents=True, exist_ok=True)
    (bundle / SBOM).write_text(json.dumps(sbom(components, made_at), indent=1) + "\n")
    (bundle / LICENCES).write_text(licences(components))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
