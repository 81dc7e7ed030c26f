"""Copies that go past the page cache are the same, whatever their size and the file system."""

import errno
import os
from pathlib import Path

import pytest

from drivers.files.durable import BLOCK, copy_past_cache

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
