"""A recording as one tar file, made piece by piece in the process `stonefall-read`, however large it is."""

import tarfile
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from service.web.reader_process import Reading

PIECE_BYTES = 4 << 20
END = bytes(2 * tarfile.BLOCKSIZE)


@dataclass(frozen=True, slots=True)
class Member:
    """A file of the recording, and what precedes and follows it in the tar file."""

    path: Path
    header: bytes
    n_bytes: int
    padding: bytes


def members_of(folder: Path) -> list[Member]:
    """Return all files of a recording."""
    members = []
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            info = tarfile.TarInfo(f"{folder.name}/{path.relative_to(folder)}")
            state = path.stat()
            info.size, info.mtime = state.st_size, int(state.st_mtime)
            padding = bytes(-info.size % tarfile.BLOCKSIZE)
            members.append(Member(path, info.tobuf(tarfile.GNU_FORMAT), info.size, padding))
    return members


def tar_bytes(members: Sequence[Member]) -> int:
    """Return the size of the tar file."""
    return sum(len(each.header) + each.n_bytes + len(each.padding) for each in members) + len(END)


async def tar_pieces(reading: Reading, members: Sequence[Member]) -> AsyncIterator[bytes]:
    """Yield the tar file; raise `OSError` when a file was removed or changed meanwhile, which ends the answer early."""
    for member in members:
        yield member.header
        for begin in range(0, member.n_bytes, PIECE_BYTES):
            yield await reading.run(read_piece, member.path, begin, min(PIECE_BYTES, member.n_bytes - begin))
        yield member.padding
    yield END


def read_piece(path: Path, begin: int, n_bytes: int) -> bytes:
    """Return a part of a file; raise `OSError` if it is shorter."""
    with path.open("rb") as file:
        file.seek(begin)
        piece = file.read(n_bytes)
    if len(piece) < n_bytes:
        raise OSError(f"{path}: became shorter")
    return piece
