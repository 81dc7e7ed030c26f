"""Make the archive: a .tar.gz of a few texts, bounded in size and time, without secrets.

Everything that goes in passes `add`, which scrubs it: known secrets wherever they stand, and what looks like one. A
part that cannot be read is named in `missing.txt` and takes nothing else with it.
"""

import gzip
import io
import json
import tarfile
import time
from collections.abc import Callable, Mapping
from typing import Any

from service.base.redaction import scrubbed, scrubbed_document
from service.daemon.diagnostics import parts
from service.daemon.diagnostics.inputs import Inputs

MAX_PART_BYTES = 4 << 20
"""The end of a longer part is kept: what is newest in a log."""
MAX_S = 15.0
"""Parts that would begin later are left out: the last is the log, which may take 10 s of a request's 30."""
FOLDER = "stonefall-diagnostics"
PARTS: Mapping[str, Callable[[Inputs], Any]] = {
    "versions.json": parts.versions,
    "host.json": parts.host,
    "store.json": parts.store,
    "calibrations.json": parts.calibrations,
    "folders.json": parts.folders,
    "log.txt": parts.log,
}
README = """What stonefall says of itself, for support: configuration, versions, health, host, store, calibrations, log.
Keys, tokens, secrets of webhooks, and all of URLs but host and first part of the path were replaced by `redacted`.
It has names of devices and addresses of the plant, but no images, no meshes and no results.
"""


def build_archive(inputs: Inputs) -> bytes:
    """Return the archive; blocks for seconds."""
    known = frozenset(inputs.secrets.all())
    texts = {"README.txt": README}
    missing = [] if inputs.live else ["health, cameras, acquisition, alarms, metrics: no daemon runs"]

    def add(name: str, content: Any) -> None:
        if isinstance(content, str):
            text = scrubbed(content, known)
        else:
            # as JSON and back: whatever was in it is plain values then
            plain = json.loads(json.dumps(content, default=str))
            text = json.dumps(scrubbed_document(plain, known), indent=1, ensure_ascii=False)
        data = text.encode()
        if len(data) > MAX_PART_BYTES:
            missing.append(f"{name}: its first {len(data) - MAX_PART_BYTES} bytes")
        texts[name] = data[-MAX_PART_BYTES:].decode(errors="ignore")

    add("configuration.json", inputs.configuration)
    for name, content in inputs.live.items():
        add(name, content)
    end_s = time.monotonic() + MAX_S
    for name, part in PARTS.items():
        if time.monotonic() > end_s:
            missing.append(f"{name}: no time was left")
            continue
        try:
            add(name, part(inputs))
        except Exception as err:  # noqa: BLE001 - of a machine where anything may be broken
            missing.append(f"{name}: {scrubbed(str(err), known)}")
    texts["missing.txt"] = "\n".join([*missing, ""]) if missing else "nothing is missing\n"
    return _packed(texts)


def _packed(texts: Mapping[str, str]) -> bytes:
    packed = io.BytesIO()
    with (
        gzip.GzipFile(fileobj=packed, mode="wb", compresslevel=6) as zipped,
        tarfile.open(fileobj=zipped, mode="w") as tar,
    ):
        for name, text in texts.items():
            data = text.encode()
            member = tarfile.TarInfo(f"{FOLDER}/{name}")
            member.size, member.mtime, member.mode = len(data), int(time.time()), 0o600
            tar.addfile(member, io.BytesIO(data))
    return packed.getvalue()
