"""Files of closed lots: each revision once, over restarts and folders that take nothing."""

import asyncio
import csv
import json
import os
import threading
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest
from support.eventually import PATIENCE_S, soon
from support.outcomes import add, measured, trigger

from service.base.language import Language
from service.base.messages import Code, message
from service.base.status import trouble_check
from service.daemon.lot_files import FilesFailedError, lot_files
from service.delivery.file_drop import ANSWER_S, FileDrop, LotFiles, due_lots, open_file_drop
from service.delivery.settings import DropFormat, FileDropSettings
from service.health.alarms.rules import load_rules
from service.lots.lots import LotDefinition, assign, close_lot, open_lot, void_lot
from service.lots.products import ProductDefinition, save_product
from service.lots.yardsticks import Request
from service.reports.lot_reports import ReportRequest, RigStanding
from service.store import Store
from service.store.reads import results_after

STONE = {
    "volume_mm3": 4000.0,
    "max_feret_mm": 30.0,
    "min_feret_mm": 9.0,
    "length_mm": 30.0,
    "width_mm": 20.0,
    "thickness_mm": 10.0,
    "volume_sd_percent": 1.0,
    "surface_sd_mm": 0.05,
    "algorithm_version": "1",
}
ALL_TIME = ("2000-01-01T00:00:00.000Z", "2100-01-01T00:00:00.000Z")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "drop"
    folder.mkdir()
    return folder


class Files:
    """Makes the files in a thread, as the daemon has them made in its reading process; counts them."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self.made: list[str] = []
        self.failing: set[str] = set()

    async def make(self, lot: str, settings: FileDropSettings) -> LotFiles | None:
        if lot in self.failing:
            raise FilesFailedError("ValueError: a figure is no number")
        wanted = ReportRequest(
            figures=Request(),
            language=Language.ENGLISH,
            rig=RigStanding(verification=None, is_overdue=False),
        )
        self.made.append(lot)
        store = self._store
        return await asyncio.to_thread(
            lot_files, store.path, store.particles_dir, lot, wanted, settings.formats
        )


@asynccontextmanager
async def dropping(drop: FileDrop, files: Files) -> AsyncIterator[FileDrop]:
    task = asyncio.create_task(drop.run(files.make))
    try:
        yield drop
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


def settings_of(folder: Path, *formats: DropFormat) -> FileDropSettings:
    return FileDropSettings(dir=folder, formats=formats or (DropFormat.CSV,))


async def drop_of(store: Store, settings: FileDropSettings, answer_s: float = PATIENCE_S) -> FileDrop:
    await open_file_drop(store, settings)
    return FileDrop(store, settings, retry_s=0.01, answer_s=answer_s)


async def opened(store: Store, lot: str) -> None:
    definition = ProductDefinition(title="basalt", density_kg_m3=2700)
    await store.write(save_product, "basalt", definition, "test")
    await store.write(open_lot, LotDefinition(lot=lot), "basalt", None, "test")


async def closed(store: Store, session: int, lot: str, sequences: Sequence[int] = ()) -> None:
    await opened(store, lot)
    for sequence in sequences:
        await add(store, session, sequence, measured(**STONE))
    await store.write(close_lot, lot, None, "test")


async def until_there(folder: Path, *names: str) -> None:
    await soon(lambda: {path.name for path in folder.iterdir()} == set(names))


async def until_noted(store: Store) -> None:
    async def is_so() -> bool:
        return not any((await store.read(due_lots)).values())

    await soon(is_so)


def rows_of(path: Path) -> dict[tuple[str, str], str]:
    with path.open(encoding="utf-8", newline="") as file:
        return {(row["section"], row["name"]): row["value"] for row in csv.DictReader(file)}


async def test_a_closed_lot_is_written_once_and_a_changed_one_again(
    store: Store, session: int, folder: Path
) -> None:
    files = Files(store)
    async with dropping(await drop_of(store, settings_of(folder)), files):
        await add(store, session, 1, measured(**STONE))  # in no lot
        await closed(store, session, "L-1", [2, 3])
        await until_there(folder, "L-1-1.csv")
        await store.write(assign, "L-1", *ALL_TIME, "test")
        await until_there(folder, "L-1-1.csv", "L-1-2.csv")
        await store.write(assign, "L-1", *ALL_TIME, "test")  # of which there are no more
        await store.write(void_lot, "L-1", "wet", "test")
        await until_there(folder, "L-1-1.csv", "L-1-2.csv", "L-1-3.csv")
    assert files.made == ["L-1"] * 3
    first, second, third = (rows_of(folder / f"L-1-{revision}.csv") for revision in (1, 2, 3))
    assert [each["lot", "revision"] for each in (first, second, third)] == ["1", "2", "3"]
    assert [each["accounting", "measured"] for each in (first, second, third)] == ["2", "3", "3"]
    assert [each["lot", "state"] for each in (first, second, third)] == ["closed", "closed", "void"]


async def test_all_formats_say_the_same_revision(store: Store, session: int, folder: Path) -> None:
    settings = settings_of(folder, *DropFormat)
    async with dropping(await drop_of(store, settings), Files(store)):
        await closed(store, session, "L1", [1])
        await until_there(folder, "L1-1.csv", "L1-1.xlsx", "L1-1.pdf", "L1-1.json")
    figures = json.loads((folder / "L1-1.json").read_text())
    assert (figures["lot"]["revision"], figures["measured"]) == (1, 1)
    assert (folder / "L1-1.pdf").read_bytes().startswith(b"%PDF")


async def test_a_lot_waits_for_its_last_stones(store: Store, session: int, folder: Path) -> None:
    async with dropping(await drop_of(store, settings_of(folder)), Files(store)):
        await opened(store, "L1")
        await store.record_triggers(session, {"00000001": trigger(1)})
        await store.write(close_lot, "L1", None, "test")
        await closed(store, session, "L2")
        await until_there(folder, "L2-1.csv")
        await store.finish(session, "00000001", measured(**STONE))
        await until_there(folder, "L1-1.csv", "L2-1.csv")
    assert rows_of(folder / "L1-1.csv")["accounting", "measured"] == "1"


async def test_what_happened_before_or_between_two_starts(store: Store, session: int, folder: Path) -> None:
    await closed(store, session, "before")
    async with dropping(await drop_of(store, settings_of(folder)), Files(store)):
        await closed(store, session, "L1")
        await until_there(folder, "L1-1.csv")
        await until_noted(store)
    await closed(store, session, "L2")
    files = Files(store)
    async with dropping(await drop_of(store, settings_of(folder)), files):
        await until_there(folder, "L1-1.csv", "L2-1.csv")
        await store.write(void_lot, "before", "wet", "test")  # what changes is due all the same
        await until_there(folder, "L1-1.csv", "L2-1.csv", "before-2.csv")
    assert files.made == ["L2", "before"]


def gone(folder: Path) -> None:
    folder.rmdir()


def in_the_way(folder: Path) -> None:
    """Have a folder where the file of the lot would be: no right of the user gets past it."""
    (folder / "L1-1.csv").mkdir()


def present(folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    if (folder / "L1-1.csv").exists():
        (folder / "L1-1.csv").rmdir()


@pytest.mark.parametrize(
    ("spoil", "words"), [(gone, "there is no such folder"), (in_the_way, "Is a directory")]
)
async def test_a_folder_that_takes_nothing_is_told_and_made_up_for(
    store: Store, session: int, folder: Path, spoil, words: str
) -> None:
    drop = await drop_of(store, settings_of(folder))
    spoil(folder)
    async with dropping(drop, Files(store)):
        await closed(store, session, "L1")
        await soon(lambda: drop.trouble is not None)
        said = message(Code.FILES_NOT_WRITTEN, reported=f"{folder}: {words}")
        assert drop.checks() == {"file_drop": trouble_check(said)}
        assert await store.read(results_after, 0, 1)  # nothing else is held up
        present(folder)
        await until_there(folder, "L1-1.csv")
        await soon(lambda: drop.trouble is None)


async def test_what_somebody_plants_in_the_folder_neither_leads_elsewhere_nor_stops_anything(
    store: Store, session: int, folder: Path
) -> None:
    elsewhere = folder.parent / "elsewhere"
    elsewhere.write_text("of the daemon")
    (folder / "L1-1.csv.tmp").symlink_to(elsewhere)
    (folder / "L1-1.csv").symlink_to(elsewhere)
    os.mkfifo(folder / "L2-1.csv.tmp")
    async with dropping(await drop_of(store, settings_of(folder)), Files(store)) as drop:
        await closed(store, session, "L1")
        await closed(store, session, "L2")
        await soon(lambda: (folder / "L2-1.csv").is_file() or drop.trouble is not None)
        assert drop.trouble is None
    assert not (folder / "L1-1.csv").is_symlink()
    assert elsewhere.read_text() == "of the daemon"


async def test_what_a_killed_daemon_left_in_the_folder_goes(store: Store, session: int, folder: Path) -> None:
    (folder / f"L1-1.csv.{16 * '0'}.tmp").touch()
    async with dropping(await drop_of(store, settings_of(folder)), Files(store)):
        await closed(store, session, "L1")
        await until_there(folder, "L1-1.csv")


def test_a_folder_that_takes_nothing_is_told_within_a_minute() -> None:
    assert ANSWER_S + load_rules().by_check["file_drop"].on_delay_s < 60


async def test_a_full_folder_is_told_and_made_up_for(
    store: Store, session: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    drop = await drop_of(store, settings_of(folder))
    async with dropping(drop, Files(store)):
        with monkeypatch.context() as patched:
            patched.setattr(os, "fsync", full)
            await closed(store, session, "L1")
            await soon(lambda: drop.trouble == f"{folder}: No space left on device")
        await until_there(folder, "L1-1.csv")


async def test_a_crash_before_the_note_writes_the_same_file_again(
    store: Store, session: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drop = await drop_of(store, settings_of(folder))
    await closed(store, session, "L1", [1])
    noting = asyncio.Event()

    async def never(*_: object) -> None:
        noting.set()
        await asyncio.Event().wait()

    with monkeypatch.context() as patched:
        patched.setattr(store, "write", never)
        async with dropping(drop, Files(store)), asyncio.timeout(PATIENCE_S):
            await noting.wait()
    files = Files(store)
    async with dropping(await drop_of(store, settings_of(folder)), files):
        await closed(store, session, "L2")
        await until_there(folder, "L1-1.csv", "L2-1.csv")
    assert files.made == ["L1", "L2"]


async def test_a_lot_whose_files_cannot_be_made_delays_no_other(
    store: Store, session: int, folder: Path
) -> None:
    files = Files(store)
    files.failing = {"L1"}
    drop = await drop_of(store, settings_of(folder))
    async with dropping(drop, files):
        await closed(store, session, "L1")
        await closed(store, session, "L2")
        await until_there(folder, "L2-1.csv")
        await soon(lambda: drop.trouble == "lot L1: ValueError: a figure is no number")
        files.failing = set()
        await until_there(folder, "L1-1.csv", "L2-1.csv")


async def test_a_folder_that_does_not_answer_is_told(
    store: Store, session: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answered = threading.Event()
    is_dir = Path.is_dir

    def slow(path: Path) -> bool:
        if path == folder:
            answered.wait(PATIENCE_S)
        return is_dir(path)

    monkeypatch.setattr(Path, "is_dir", slow)
    drop = await drop_of(store, settings_of(folder), answer_s=0.05)
    async with dropping(drop, Files(store)):
        await closed(store, session, "L1")
        await soon(lambda: drop.trouble == f"{folder} has not answered for 0.05 s")
        answered.set()
        await until_there(folder, "L1-1.csv")


async def test_a_stop_ends_all_waiting(store: Store, folder: Path) -> None:
    running = asyncio.create_task((await drop_of(store, settings_of(folder))).run(Files(store).make))
    await asyncio.sleep(0)
    store.release_waiters()
    async with asyncio.timeout(PATIENCE_S):
        await running
    await FileDrop(store, None).run(Files(store).make)


def test_files_that_cannot_be_made_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(FilesFailedError) as raised:
        lot_files(tmp_path / "none", tmp_path, "L1", None, (DropFormat.CSV,))  # type: ignore[arg-type]
    assert "\n" not in str(raised.value)
    assert "unable to open database file" in str(raised.value)
