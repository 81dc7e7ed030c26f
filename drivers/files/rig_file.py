"""Read and write rig files: the JSON document of `pipeline.rig.document` on disk."""

from pathlib import Path

from drivers.errors import RecordingError
from drivers.files.durable import read_json, write_json
from pipeline.errors import RigError
from pipeline.rig.cameras import RigCalibration, rig_to_document
from pipeline.rig.document import rig_from_document


def read_rig(path: Path) -> RigCalibration:
    """Read a rig file.

    Raises
    ------
    RecordingError
        Names the file and the field that is damaged, missing or implausible.
    """
    document = read_json(path)
    try:
        return rig_from_document(document)
    except RigError as err:
        raise RecordingError(path, str(err)) from err


def write_rig(path: Path, rig: RigCalibration) -> None:
    """Write a rig with its checksum, durably."""
    write_json(path, rig_to_document(rig))
