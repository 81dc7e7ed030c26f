#!/usr/bin/env python3
"""Print digests of what `stonefall measure` wrote, so that two versions can be shown to agree bit for bit.

    python tests/benchmarks/fingerprint.py OUT [OUT ...] [--without FIELD]

Results are digested field by field without the timings, which differ from run to run, and without fields that only
one of the versions has (`--without`); meshes, silhouettes and the gradation byte by byte. Equal lines mean equal files.
Recordings and machine must be the same for both versions.
"""

import argparse
import hashlib
import json
import sys
from pathlib import Path

TIMED = "timings_ms"


def digest(texts: list[bytes]) -> str:
    """Return the first 16 hexadecimal digits of the sha256 of all texts."""
    return hashlib.sha256(b"\0".join(texts)).hexdigest()[:16]


def fields_digest(results: Path, without: set[str]) -> tuple[int, str]:
    """Return the number of results and the digest of their fields, in the order in which they are written."""
    records = [json.loads(line) for line in results.read_text().splitlines()]
    compared = [{name: record[name] for name in record if name not in without} for record in records]
    return len(records), digest([json.dumps(record).encode() for record in compared])


def files_digest(folder: Path, pattern: str) -> tuple[int, str]:
    """Return the number of files below a folder and the digest of their names and bytes."""
    files = sorted(folder.rglob(pattern))
    return len(files), digest(
        [each for path in files for each in (str(path.relative_to(folder)).encode(), path.read_bytes())]
    )


def main() -> None:
    """Print a line for each kind of file of each folder."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, nargs="+", help="a folder that `stonefall measure` wrote")
    parser.add_argument("--without", action="append", default=[TIMED], help="a field that is not compared")
    arguments = parser.parse_args()
    for out in arguments.out:
        for kind, (count, value) in {
            "results": fields_digest(out / "results.jsonl", set(arguments.without)),
            "meshes": files_digest(out / "meshes", "*.ply"),
            "silhouettes": files_digest(out / "silhouettes", "*.png"),
            "gradation": files_digest(out, "gradation.json"),
        }.items():
            sys.stdout.write(f"{out}  {kind:11}  {count:4}  {value}\n")


if __name__ == "__main__":
    main()
