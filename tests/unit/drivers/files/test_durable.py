"""What is written durably is whole and harms nothing else; copies past the page cache are the same."""

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.errors import RecordingError
from drivers.files import durable
from drivers.files.durable import (
    BLOCK,
    copy_past_cache,
    read_json,
    remove_unfinished,
    replacing,
    unfinished,
    write_file,
)

SIZES = [1, BLOCK - 1, BLOCK, BLOCK + 1, 300 * BLOCK + 77]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("folder", ["/dev/shm", "disk"])  # noqa: S108 - where the spool is
def test_a_copy_is_the_same(size: int, folder: str, tmp_path: Path) -> None:
    source = Path(folder) / f"stonefall-test-{os.getpid()}" if folder != "disk" else tmp_path / "source"
    target = tmp_path / "target"
    target.write_bytes(b"x" * 2 * size)  # a longer one
    try:
        source.write_bytes(os.urandom(size))
        copy_past_cache(source, target)
        assert target.read_bytes() == source.read_bytes()
    finally:
        source.unlink()


def test_a_file_system_without_it_gets_its_copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refusing(path: Path, flags: int, mode: int = 0o777) -> int:
        if flags & os.O_DIRECT:
            raise OSError(errno.EINVAL, "Invalid argument")
        return opened(path, flags, mode)

    opened = os.open
    monkeypatch.setattr(os, "open", refusing)
    source = tmp_path / "source"
    source.write_bytes(os.urandom(3 * BLOCK))
    copy_past_cache(source, tmp_path / "target")
    assert (tmp_path / "target").read_bytes() == source.read_bytes()


def test_a_full_disk_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int, content: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    source = tmp_path / "source"
    source.write_bytes(os.urandom(3 * BLOCK))
    monkeypatch.setattr(os, "write", full)
    with pytest.raises(OSError, match="No space"):
        copy_past_cache(source, tmp_path / "target")


@contextmanager
def planted(path: Path, kind: str, target: Path) -> Iterator[None]:
    """Have a link to a file of somebody else, or a pipe, where something is going to be written."""
    target.write_text("of somebody else")
    if kind == "link":
        path.symlink_to(target)
        yield
    else:
        os.mkfifo(path)
        reader = os.open(path, os.O_RDWR)  # else writing would wait for ever where it should not even begin
        try:
            yield
        finally:
            os.close(reader)
    assert target.read_text() == "of somebody else"


@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_what_lies_under_the_temporary_name_is_not_written_to(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "folder" / "file"
    path.parent.mkdir()
    with planted(unfinished(path), kind, tmp_path / "target"):
        with replacing(path, 0o600) as temporary:
            temporary.write_text("content")
        assert path.read_text() == "content"
        assert path.stat().st_mode & 0o777 == 0o600
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_a_name_that_was_guessed_is_refused(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(secrets, "token_hex", lambda n: 2 * n * "a")
    with (
        planted(tmp_path / f"file.{16 * 'a'}.tmp", kind, tmp_path / "target"),
        pytest.raises(FileExistsError),
    ):
        write_file(tmp_path / "file", b"content")
    assert not (tmp_path / "file").exists()


def test_what_was_there_under_the_name_itself_is_replaced_not_followed(tmp_path: Path) -> None:
    path = tmp_path / "file"
    with planted(path, "link", tmp_path / "target"):
        write_file(path, b"content")
        assert not path.is_symlink()
        assert path.read_bytes() == b"content"


def test_a_killed_process_leaves_a_file_that_goes_and_a_failed_one_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched, pytest.raises(OSError, match="No space"):
        patched.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(errno.ENOSPC, "No space left")))
        write_file(tmp_path / "file", b"content")
    assert list(tmp_path.iterdir()) == []
    kept = [tmp_path / name for name in ("L1.csv", "L1.csv.tmp", f"L1.{16 * 'g'}.tmp")]
    left = tmp_path / f"L1.csv.{secrets.token_hex(8)}.tmp"
    for path in (*kept, left):
        path.touch()
    (tmp_path / f"L1.csv.{16 * '0'}.tmp").mkdir()  # not ours
    remove_unfinished(tmp_path)
    assert not left.exists()
    assert all(path.exists() for path in kept)


def test_a_document_larger_than_any_of_ours_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(durable, "MAX_JSON_BYTES", 100)
    path = tmp_path / "document.json"
    path.write_text('"' + 98 * "a" + '"')
    assert read_json(path) == 98 * "a"
    path.write_text('"' + 99 * "a" + '"')
    with pytest.raises(RecordingError, match="more than 100 bytes"):
        read_json(path)


def test_no_file_takes_the_place_of_a_device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "null").write_bytes(b"kept")
    monkeypatch.setattr(Path, "is_char_device", lambda path: path.name == "null")
    with pytest.raises(OSError, match="is a device"):
        write_file(tmp_path / "null", b"new")
    with pytest.raises(OSError, match="is a device"), replacing(tmp_path / "null"):
        pass
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"kept"]
