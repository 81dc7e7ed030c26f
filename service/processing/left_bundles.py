"""Take over the bundles that a killed daemon left on tmpfs, so that the next one measures them, once.

Each session has a folder of its own, because names of bundles repeat. The next session moves into its own what is
worth it, by renaming: complete bundles whose trigger has no outcome yet, as `left-<session>-<deaths>-<file>.tiff`, and
the newest background of each session, which they are measured with. Everything else in there goes. A daemon that is
killed meanwhile leaves either the old name or the new one.

`deaths` counts the daemons that ended while a worker had the bundle: the folder of its job is there. After
`MAX_DEATHS` it is not measured again, or one bundle could end every daemon for ever: it goes into quarantine.
"""

import logging
import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, Self

from drivers.errors import RecordingError
from drivers.files.bundle_file import read_header
from drivers.files.durable import replacing
from drivers.files.recording import read_bundle
from drivers.interfaces import FrameLossReason
from pipeline.frames import BundleKind, CameraId
from service.base.messages import Code, message
from service.base.status import Checks, trouble_check
from service.processing.spool import LEFT, LEFT_BACKGROUND, LeftBundle, remove_backgrounds

log = logging.getLogger(__name__)

MAX_DEATHS = 3
"""Daemons that may end over a bundle; systemd starts the fifth one at most."""
MAX_BUNDLES = 20
"""Files in quarantine, 21 MB each; the first ones, as a cause that comes again and again looks alike."""
JOB = "job-"
"""Before a bundle's name in the name of its job's folder, which a worker creates when it begins."""
BACKGROUND = "background-"
"""Begins the name of a complete background model's folder; those of a session are in the order of their names."""

OpenTrigger = tuple[int, str]
"""A trigger without an outcome: its session, and the name of its bundle."""


class Quarantine:
    """A folder on the store's disk of bundles that no worker survived; people find the cause and delete them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def keep(self, path: Path, session: int, name: str) -> None:
        """Copy a bundle's file; a full disk, or folder, is logged and not raised. Called on a thread."""
        kept = self.folder / f"{session}-{name}.tiff"
        if len(self.bundles()) >= MAX_BUNDLES:
            log.error("bundle not kept, %d are in quarantine folder=%s", MAX_BUNDLES, self.folder)
            return
        try:
            self.folder.mkdir(exist_ok=True)
            with replacing(kept) as unfinished:
                shutil.copyfile(path, unfinished)
        except OSError as err:
            log.error("bundle not kept: %s file=%s", err, kept)
        else:
            log.error("bundle in quarantine file=%s", kept)

    def bundles(self) -> list[str]:
        """Return the names of the files, `<session>-<bundle>.tiff`, that are there now."""
        return sorted(path.name for path in self.folder.glob("*.tiff"))

    def checks(self) -> Checks:
        bundles = self.bundles()
        trouble = message(Code.QUARANTINE, bundles=", ".join(bundles)) if bundles else None
        return {"quarantine": trouble_check(trouble, len(bundles), "bundles")}


class _Name(NamedTuple):
    """Parts of a file's name in the folder of a session."""

    session: int
    deaths: int
    file: str

    @classmethod
    def read(cls, stem: str, session: int) -> Self:
        if not stem.startswith(LEFT):
            return cls(session, 0, stem)
        left_by, deaths, file = stem.removeprefix(LEFT).split("-", 2)
        return cls(int(left_by), int(deaths), file)

    def __str__(self) -> str:
        return f"{LEFT}{self.session}-{self.deaths}-{self.file}"


def take_over(
    folder: Path,
    session: int,
    open_triggers: Sequence[OpenTrigger],
    camera_ids: Sequence[CameraId],
    quarantine: Quarantine,
) -> list[LeftBundle]:
    """Create the session's folder in `folder`, and return the bundles taken over, in the order of `open_triggers`."""
    own = folder / str(session)
    shutil.rmtree(own, ignore_errors=True)  # of a store that was rolled back since
    own.mkdir(parents=True)
    order = {trigger: place for place, trigger in enumerate(open_triggers)}
    taken: dict[int, LeftBundle] = {}
    for other in sorted(folder.iterdir()):
        if other == own:
            continue
        if other.name.isdecimal():
            _take_backgrounds(other, own)
            for path in sorted(other.glob("*.tiff")):
                bundle = _taken(path, own, order, camera_ids, quarantine)
                if bundle is not None:
                    taken[order[bundle.session, bundle.name]] = bundle
        _remove(other)
    left = [taken[place] for place in sorted(taken)]
    if not left:
        remove_backgrounds(own)
    return left


def bundles_in(folder: Path) -> set[OpenTrigger]:
    """Return session and name of the bundles that lie in `folder`, as far as their files can be read."""
    found = set()
    for path in folder.glob("*/*.tiff"):
        with suppress(RecordingError, ValueError):
            session = _Name.read(path.stem, int(path.parent.name)).session
            found.add((session, read_header(path).name))
    return found


def job_folder(path: Path) -> str:
    """Return the name of the folder that the worker of a bundle's file writes to."""
    return JOB + path.stem


def _taken(
    path: Path,
    own: Path,
    order: dict[OpenTrigger, int],
    camera_ids: Sequence[CameraId],
    quarantine: Quarantine,
) -> LeftBundle | None:
    """Move a bundle into the folder of this session; return None if it is not to be measured."""
    try:
        name = _Name.read(path.stem, int(path.parent.name))
        bundle = read_bundle(path, camera_ids)
    except (RecordingError, ValueError) as err:
        log.warning("a bundle of an earlier session cannot be read: %s", err)
        return None
    if bundle.kind is BundleKind.BACKGROUND or (name.session, bundle.name) not in order:
        return None
    if FrameLossReason.DAMAGED in bundle.missing.values():
        log.warning(
            "a bundle of an earlier session is incomplete session=%d bundle=%s", name.session, bundle.name
        )
        return None
    name = name._replace(deaths=name.deaths + (path.parent / job_folder(path)).exists())
    if name.deaths >= MAX_DEATHS:
        log.error(
            "%d daemons ended over a bundle session=%d bundle=%s", name.deaths, name.session, bundle.name
        )
        quarantine.keep(path, name.session, bundle.name)
        return None
    background = own / LEFT_BACKGROUND.format(name.session)
    return LeftBundle(
        session=name.session,
        trigger=bundle.trigger,
        name=bundle.name,
        content=path.rename(own / f"{name}.tiff"),
        background=background if background.exists() else None,
    )


def _take_backgrounds(other: Path, own: Path) -> None:
    """Move the newest background that a session learnt, and those that it had taken over itself."""
    targets = {path: own / path.name for path in other.glob(LEFT_BACKGROUND.format("*"))}
    targets |= {
        path: own / LEFT_BACKGROUND.format(other.name) for path in sorted(other.glob(f"{BACKGROUND}*"))[-1:]
    }
    for path, target in targets.items():
        if not target.exists():
            path.rename(target)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
