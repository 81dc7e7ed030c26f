"""Files that others write have a bound: one without an end, or one that nobody writes to, is refused with its name."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import RecordingError
from drivers.files.bounded import read_bounded
from drivers.files.durable import read_json
from drivers.files.image_file import read_image
from drivers.files.mesh_parsing import parse_mesh
from service.base.errors import SettingsError, StoreError, VolumeModelError
from service.base.tables.files import read_rows
from service.base.tables.lines import TableError
from service.configuration.settings import load_settings
from service.configuration.volume_models import read_volume_model
from service.delivery.settings import WebhookEndpoint
from service.store.keys import keys_of_file


def rows_of(path: Path) -> object:
    return read_rows(path, {}, ())


def secret_of(path: Path) -> list[bytes]:
    return WebhookEndpoint(name="mes", url="https://mes/", secret_files=(path,)).keys()


READERS = [
    (load_settings, SettingsError),
    (read_json, RecordingError),
    (read_image, RecordingError),
    (parse_mesh, RecordingError),
    (keys_of_file, StoreError),
    (read_volume_model, VolumeModelError),
    (secret_of, ValueError),
    (rows_of, TableError),
]


@pytest.mark.parametrize(("read", "error"), READERS)
def test_a_file_without_an_end_is_refused(read: Callable[[Path], Any], error: type[Exception]) -> None:
    with pytest.raises(error, match=r"/dev/zero: .*has more than \d+ bytes"):
        read(Path("/dev/zero"))


@pytest.mark.parametrize(("read", "error"), READERS[1:])
def test_nobody_waits_for_who_writes_to_a_pipe(
    tmp_path: Path, read: Callable[[Path], Any], error: type[Exception]
) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(error, match="pipe: "):
        read(tmp_path / "pipe")


def test_what_a_pipe_holds_so_far_is_not_taken_for_all(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    writer = os.open(tmp_path / "pipe", os.O_RDWR)
    try:
        for part in (b"", b"id,serial\n"):
            os.write(writer, part)
            with pytest.raises(OSError, match="is a pipe"):
                read_bounded(tmp_path / "pipe", 100)
    finally:
        os.close(writer)


def test_a_file_of_the_largest_size_is_read_whole(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"abc")
    assert read_bounded(tmp_path / "file", 3) == b"abc"
    with pytest.raises(OSError, match="has more than 2 bytes"):
        read_bounded(tmp_path / "file", 2)
