"""Look at a release before the switch: what it changes, and how the results of this rig's own stones would shift.

The new release lies beside the current one, whose daemon goes on measuring; each measures the newest archived stones in
its own environment, as a process of low priority.
"""

import json
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from installer import placement, service
from installer.host import USER, Host, InstallError, say
from installer.releases import Release

LIMITS = {
    "--max-volume-percent": 0.7,
    "--max-sieve-mm": 0.05,
    "--max-axes-mm": 0.1,
    "--max-shape": 0.02,
    "--max-passing-percent": 0.5,
}
"""Shifts of a stone, and of the passing, beyond which one is told: three times the spread of a single measurement."""
MOST_NAMED = 20
SMALLEST = 5e-5
"""Least difference of a lot's figure that is printed."""


def review(host: Host, previous: Release | None, target: Release, n_stones: int) -> bool:
    """Print what a switch changes; return whether results stay within the limits, True where none can be compared."""
    if previous is None:
        say("review", f"{target.version} is the first release here: nothing to compare with")
        return True
    for line in (
        *_versions(host, previous, target),
        *_schema(previous, target),
        *_settings(host, previous, target),
    ):
        say("review", line)
    return _compare(host, previous, target, n_stones)


def _versions(host: Host, previous: Release, target: Release) -> Iterator[str]:
    said = [service.stonefall(host, release, "--version").stdout.strip() for release in (previous, target)]
    yield f"{said[0]}  ->  {said[1]}"
    old, new = (re.search(r"algorithm (\S+)", each) for each in said)
    if old and new and old[1] != new[1]:
        yield f"algorithm {old[1]} -> {new[1]}: what each version changed is in service/remeasuring/README.md"


def _schema(previous: Release, target: Release) -> Iterator[str]:
    if target.schema > previous.schema:
        yield (
            f"database: schema {previous.schema} -> {target.schema}, migrated at the first start; {previous.version}"
            " cannot read it then: going back restores the backup of the switch"
        )
    elif target.schema < previous.schema:
        yield f"database: schema {previous.schema} -> {target.schema}: an older release, see --restore"


def _settings(host: Host, previous: Release, target: Release) -> Iterator[str]:
    """Yield the settings that are new, gone, or have another default, as the releases read the same file."""
    old, new = (service.read_settings(host, release) for release in (previous, target))
    if old is None or new is None:
        unread = target if new is None else previous
        yield f"configuration: {unread.version} cannot read {placement.CONFIGURATION}"
        return
    before, after = _flat(old), _flat(new)
    found = [
        *(f"setting new: {name} = {_text(after[name])}" for name in after.keys() - before.keys()),
        *(f"setting gone: {name} (was {_text(before[name])})" for name in before.keys() - after.keys()),
        *(
            f"default changed: {name}: {_text(before[name])} -> {_text(after[name])}"
            for name in before.keys() & after.keys()
            if before[name] != after[name]
        ),
    ]
    yield from sorted(found) if found else ["configuration: no setting is new, gone or another"]


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return all values by `section.field`, sections within sections too."""
    flat: dict[str, Any] = {}
    for name, value in settings.items():
        inner = _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {}
        flat |= inner or {f"{prefix}{name}": value}
    return flat


def _text(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:59]}…"


def _compare(host: Host, previous: Release, target: Release, n_stones: int) -> bool:
    """Print how the results of the newest archived stones shift; return whether all is within the limits."""
    work = Path(tempfile.mkdtemp(prefix="stonefall-review-", dir="/var/tmp"))
    try:
        shutil.chown(work, USER)
        recording = work / "recording"
        archive = ("archive", recording, "--config", placement.CONFIGURATION, "--newest", n_stones)
        done = service.stonefall(host, target, *archive)
        if done.returncode != 0:
            say("review", f"results were not compared: {_last_line(done.stderr)}")
            return True
        say("review", done.stdout.strip().partition(": ")[2])
        sides = [work / release.version for release in (previous, target)]
        for release, out in zip((previous, target), sides, strict=True):
            options = ("--out", out, "--config", placement.CONFIGURATION, "--workers", 1, "--json")
            measured = service.stonefall(host, release, "measure", recording, *options, is_idle=True)
            if measured.returncode != 0:
                raise InstallError(
                    f"{release.version} does not measure the archived stones: {_last_line(measured.stderr)}"
                )
            say("measured", f"by {release.version}")
        limits = [str(word) for pair in LIMITS.items() for word in pair]
        compared = service.stonefall(host, target, "compare", *sides, *limits, "--same-words", "--json")
        try:
            return _say_shifts(json.loads(compared.stdout))
        except ValueError as err:
            raise InstallError(f"compare of {target.version}: {_last_line(compared.stderr) or err}") from err
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _last_line(stderr: str) -> str:
    return stderr.strip().rpartition("\n")[2]  # before it may be the bar of a progress


def _say_shifts(document: Mapping[str, Any]) -> bool:
    stones = document["stones"]
    changed = [each for each in stones["fields"] if each["n_changed"]]
    if not changed and not stones["words"]:
        say("review", f"{stones['n_common']} stones: all results are equal, bit for bit")
        return True
    say("review", f"{stones['n_common']} stones, of which the new release gives otherwise:")
    for each in changed:
        largest = each["largest"][0]
        unit = each["unit"] or ""
        say(
            "",
            f"{each['field']:22}{each['n_changed']:4} of {each['n_stones']}, mean {each['mean']:+.4f} {unit}, rms"
            f" {each['rms']:.4f}, largest {largest['change']:+.4f} ({largest['id']})",
        )
    for each in document["lot"]:
        if abs(each["difference"] or 0.0) >= SMALLEST:
            say("", f"as a lot: {each['figure']} {each['difference']:+.4f}")
    beyond = document["beyond"]
    for line in beyond[:MOST_NAMED]:
        say("beyond", line)
    if len(beyond) > MOST_NAMED:
        say("beyond", f"and {len(beyond) - MOST_NAMED} more")
    return not beyond


def may_switch(target: Release, *, is_within: bool, is_agreed: bool) -> bool:
    """Ask whether to switch; without a terminal only `is_agreed` within the limits is a yes."""
    if is_agreed and is_within:
        return True
    if not sys.stdin.isatty():
        say("review", "nobody can be asked here: --yes switches as long as shifts are within the limits")
        return False
    warning = "" if is_within else "Results shift beyond the limits above. "
    return input(f"{warning}Switch to {target.version}? [y/N] ").strip().lower() in ("y", "yes")
