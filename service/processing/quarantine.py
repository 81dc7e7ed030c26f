"""Keep the bundles that no worker survived, to find the cause; they are not measured again."""

import logging
import shutil
from pathlib import Path

from drivers.files.durable import replacing
from service.base.status import Checks, trouble_check

log = logging.getLogger(__name__)

MAX_BUNDLES = 20
"""Files that are kept, 21 MB each; the first ones, as a cause that comes again and again looks alike."""


class Quarantine:
    """A folder of bundle files on the store's disk; people look at them and delete them."""

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
        trouble = f"no worker survived {', '.join(bundles)}" if bundles else None
        return {"quarantine": trouble_check(trouble, len(bundles), "bundles")}
