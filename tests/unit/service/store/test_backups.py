"""Copies of the database are whole, checked, and can be put in its place."""

import asyncio
import os
import shutil
import signal
import sqlite3
import sys
from collections.abc import Callable
from contextlib import closing
from functools import partial
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support.eventually import PATIENCE_S
from support.extents import first_quick
from support.outcomes import add, measured
from support.rest import particle_files
from support.stores import folder_of
from typer.testing import CliRunner

from service.base import aside
from service.base.errors import StoreError
from service.base.messages import Code, message
from service.base.status import trouble_check
from service.commands.cli import build_app
from service.configuration.settings import StoreSettings
from service.daemon.backing_up import BackingUp
from service.store import Store, backups, history, open_store
from service.store.backups import back_up, restore
from service.store.history import backups_in
from service.store.reads import particle, results_after
from service.store.trouble import TroubleCause


async def add_with_files(store: Store, session: int, number: int, folder: Path) -> int:
    return await add(store, session, number, measured(), particle_files(folder / "out"))


def ends_of(path: Path) -> tuple[str, int, int]:
    """Return identity, last number and number of results of a database file."""
    with closing(sqlite3.connect(path)) as database:
        (n_results,) = database.execute("SELECT count(*) FROM results").fetchone()
        instance_id, last_seq = database.execute("SELECT instance_id, last_seq FROM store").fetchone()
    return instance_id, last_seq, n_results


async def test_a_backup_while_results_are_written_is_of_one_moment(
    store: Store, session: int, tmp_path: Path, state_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(backups, "PAGES", 1)
    for number in range(20):
        await add(store, session, number, measured(text="x" * 9000))
    copying = asyncio.create_task(asyncio.to_thread(back_up, state_dir, tmp_path / "copy.sqlite"))
    number = 20
    while not copying.done():
        await add(store, session, number, measured())
        number += 1
    await copying
    instance_id, last_seq, n_results = ends_of(tmp_path / "copy.sqlite")
    assert (instance_id, last_seq) == (store.instance_id, n_results)
    assert 20 <= n_results < number
    assert not list(store.particles_dir.parents[1].glob("copy.sqlite?*"))


async def test_the_newest_backups_are_kept(store: Store, session: int, state_dir: Path) -> None:
    assert backups_in(store.dir) == []
    for name in ("results-20200101T000000Z.sqlite", "results-20200102T000000Z.sqlite"):
        (state_dir / "backups").mkdir(exist_ok=True)
        (state_dir / "backups" / name).touch()
    for end in ("", "-wal"):  # of one that was killed
        (state_dir / "backups" / f"results-20200103T000000Z.sqlite.tmp{end}").touch()
    made = await store.back_up(keep=2)
    assert [path.name for path in backups_in(state_dir)] == ["results-20200102T000000Z.sqlite", made.name]
    assert backups_in(state_dir) == sorted((state_dir / "backups").iterdir())
    assert backups_in(store.dir)[-1] == made


async def test_a_backup_made_by_a_clock_that_was_set_back_is_kept(
    store: Store, session: int, state_dir: Path
) -> None:
    (state_dir / "backups").mkdir()
    later = [f"results-2999010{day}T000000Z.sqlite" for day in (1, 2, 3)]
    for name in later:
        (state_dir / "backups" / name).touch()
    made = await store.back_up(keep=2)
    assert [path.name for path in backups_in(state_dir)] == [made.name, later[-1]]


async def test_a_damaged_database_replaces_no_backup_and_holds_the_store(
    store: Store, session: int, state_dir: Path
) -> None:
    await add(store, session, 1, measured(text="x" * 100_000))
    good = await store.back_up(keep=1)
    path = state_dir / "results.sqlite"
    with closing(sqlite3.connect(path)) as other:
        other.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    content = path.read_bytes()
    path.write_bytes(content[:8192] + b"\xa5" * (len(content) - 8192))
    with pytest.raises(StoreError):
        await store.back_up(keep=1)
    assert backups_in(state_dir) == [good]
    assert store.trouble is not None
    assert store.trouble.cause is TroubleCause.DAMAGED


async def test_without_room_there_is_no_backup(
    store: Store, state_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(backups.shutil, "disk_usage", lambda folder: SimpleNamespace(free=1 << 30))
    with pytest.raises(StoreError, match=r"it needs 1\.1 GB"):
        await store.back_up(keep=1)
    assert backups_in(state_dir) == []


async def test_a_restored_backup_is_a_new_history_and_nothing_is_deleted(
    state_dir: Path, tmp_path: Path
) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        session = await store.begin_session({})
        for number in (1, 2):
            await add_with_files(store, session, number, tmp_path)
        backup = await store.back_up(keep=4)
        await add_with_files(store, session, 3, tmp_path)
        before = store.instance_id
        with pytest.raises(StoreError, match="another process has the store open"):
            await asyncio.to_thread(restore, backup, state_dir)
    await asyncio.to_thread(restore, backup, state_dir)
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert store.instance_id != before
        assert [item["seq"] for item in (await store.read(results_after, 0, 10)).items] == [1, 2]
        for seq in (1, 2):
            record = await store.read(particle, seq)
            assert record is not None
            assert (folder_of(state_dir, record["id"]) / "mesh.ply").exists()
        session = await store.begin_session({})
        assert await add_with_files(store, session, 4, tmp_path) == 4
        assert len(store.incidents) == 1
    (former,) = (state_dir / "aside").glob("*-before-restore/results.sqlite")
    assert ends_of(former) == (before, 3, 3)
    assert len(list(former.parent.glob("particles/*/mesh.ply"))) == 1


async def test_particles_that_were_moved_aside_come_back_with_their_results(
    state_dir: Path, tmp_path: Path
) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        await add_with_files(store, await store.begin_session({}), 1, tmp_path)
        backup = await store.back_up(keep=4)
    (state_dir / "results.sqlite").write_bytes(b"\xa5" * 10_000)
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert not any(store.particles_dir.glob("*/*"))
    await asyncio.to_thread(restore, backup, state_dir)
    with await asyncio.to_thread(open_store, state_dir) as store:
        record = await store.read(particle, 1)
        assert record is not None
        assert (folder_of(state_dir, record["id"]) / "mesh.ply").exists()


@pytest.mark.parametrize("content", [b"this is a diary " * 1000, b"", None])
async def test_what_is_no_backup_changes_nothing(
    state_dir: Path, tmp_path: Path, content: bytes | None
) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        before = store.instance_id
    wrong = tmp_path / "wrong.sqlite"
    if content is not None:
        wrong.write_bytes(content)
    with pytest.raises(StoreError, match=r"wrong\.sqlite"):
        restore(wrong, state_dir)
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert (store.instance_id, store.incidents) == (before, [])


@pytest.mark.parametrize("source", ["/dev/zero", "/dev", "/none"])
async def test_what_is_no_file_is_not_copied(state_dir: Path, source: str) -> None:
    """`stonefall restore /dev/zero` filled the disk."""
    with pytest.raises(StoreError, match=f"{source}: is no file"):
        restore(Path(source), state_dir)


class BackupsOfTest:
    """In the place of the store: the first backup fails."""

    dir = Path("no backups")

    def __init__(self) -> None:
        self.n_made = 0
        self.made = asyncio.Event()

    async def back_up(self, keep: int) -> Path:
        self.n_made += 1
        if self.n_made == 1:
            raise StoreError("no room")
        self.made.set()
        return Path("backup")


def every(hours: float) -> StoreSettings:
    return StoreSettings(dir=Path("state"), backup_every_h=hours)


async def test_backups_are_made_by_themselves_and_a_failure_is_told() -> None:
    store: Any = BackupsOfTest()
    backing_up = BackingUp(store, every(1e-6))
    task = asyncio.create_task(backing_up.run())
    while backing_up.trouble is None:  # noqa: ASYNC110 - it is no event
        await asyncio.sleep(0)
    assert backing_up.checks() == {"backup": trouble_check(message(Code.BACKUP_FAILED, reported="no room"))}
    await asyncio.wait_for(store.made.wait(), PATIENCE_S)
    while backing_up.trouble is not None:  # noqa: ASYNC110 - as above
        await asyncio.sleep(0)
    task.cancel()


async def test_without_an_interval_none_is_made_until_there_is_one() -> None:
    store: Any = BackupsOfTest()
    backing_up = BackingUp(store, every(0))
    task = asyncio.create_task(backing_up.run())
    await asyncio.sleep(0.05)
    assert store.n_made == 0
    backing_up.use(every(1e-6))
    await asyncio.wait_for(store.made.wait(), PATIENCE_S)
    task.cancel()


async def test_an_hour_after_the_newest_backup_the_next_is_due(store: Store) -> None:
    assert BackingUp(store, every(1))._due_in_s() == 0
    await store.back_up(keep=4)
    assert 3000 < BackingUp(store, every(1))._due_in_s() <= 3600


def test_the_commands_back_up_and_restore(tmp_path: Path) -> None:
    open_store(tmp_path / "state").close()
    config = tmp_path / "stonefall.toml"
    config.write_text(f'[rig]\nrecording = "{tmp_path}"\n[spool]\ndir = "spool"\n[store]\ndir = "state"\n')
    run = CliRunner().invoke
    app = build_app(["backup", "restore"])
    with open_store(tmp_path / "state"):  # as the daemon has it
        made = run(app, ["backup", "--config", str(config)])
        assert made.exit_code == 0, made.output
        assert [made.stdout.strip()] == [str(path) for path in backups_in(tmp_path / "state")]
        elsewhere = tmp_path / "elsewhere" / "copy.sqlite"
        assert run(app, ["backup", "--config", str(config), str(elsewhere)]).exit_code == 0
        refused = run(app, ["restore", str(elsewhere), "--config", str(config)])
        assert isinstance(refused.exception, StoreError)
    restored = run(app, ["restore", str(elsewhere), "--config", str(config)])
    assert restored.exit_code == 0, restored.output
    assert "before-restore" in restored.stdout


def killed_at(step: int, work: Callable[[], object]) -> bool:
    """Kill a process that does `work` before its change number `step` to the file system; False if it ends first."""
    if (child := os.fork()) == 0:
        n_steps = 0

        def kill_then(event: str, arguments: tuple[object, ...]) -> None:
            nonlocal n_steps
            is_writing = event == "open" and isinstance(arguments[2], int) and arguments[2] & os.O_ACCMODE
            if event in {"os.rename", "os.remove", "os.mkdir", "sqlite3.connect"} or is_writing:
                n_steps += 1
                if n_steps == step:
                    os.kill(os.getpid(), signal.SIGKILL)

        try:
            sys.addaudithook(kill_then)
            work()
            os._exit(0)
        finally:
            os._exit(1)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0
    return os.WIFSIGNALED(status)


def meshes_and_rests(state_dir: Path) -> tuple[int, list[str]]:
    """Return the number of meshes, wherever they lie, and what a restore has left unfinished."""
    rests = [path.name for name in ("restoring*", "*.restored*") for path in state_dir.glob(name)]
    return len(list(state_dir.rglob("mesh.ply"))), rests


def meshes_in_place(state_dir: Path) -> set[str]:
    return {path.parent.name for path in state_dir.glob("particles/*/*/mesh.ply")}


@pytest.fixture
async def backed_up(state_dir: Path, tmp_path: Path) -> tuple[Path, list[str]]:
    """Return a backup of two results, the first of which was moved aside since, and the ids of all three."""
    with await asyncio.to_thread(open_store, state_dir) as store:
        session = await store.begin_session({})
        for number in (1, 2):
            await add_with_files(store, session, number, tmp_path)
        backup = await store.back_up(keep=4)
        await add_with_files(store, session, 3, tmp_path)
        names = [item["id"] for item in (await store.read(results_after, 0, 10)).items]
    history.move_particles([folder_of(state_dir, names[0])], aside.new_folder(state_dir, "strays"))
    return backup, names


async def require_one_whole_history(state_dir: Path, names: list[str], former: tuple[str, int, int]) -> bool:
    """Fail unless the next start has the former history or the restored one, whole; True for the latter."""
    with await asyncio.to_thread(open_store, state_dir) as store:
        served = [item["id"] for item in (await store.read(results_after, 0, 10)).items]
        is_restored = store.instance_id != former[0]
        assert served == (names[:2] if is_restored else names)
        assert meshes_in_place(state_dir) == set(names[:2] if is_restored else names[1:])
        assert len(store.incidents) == (2 if is_restored else 1)
        assert await add(store, await store.begin_session({}), 9, measured()) == 4
    if is_restored:
        (aside,) = (state_dir / "aside").glob("*-before-restore/results.sqlite")
        assert ends_of(aside) == former
    assert meshes_and_rests(state_dir) == (3, [])
    return is_restored


@pytest.mark.parametrize("every", first_quick([5, 1]))
async def test_a_restore_that_is_killed_at_any_step_leaves_one_history_whole(
    state_dir: Path, tmp_path: Path, backed_up: tuple[Path, list[str]], every: int
) -> None:
    backup, names = backed_up
    former = ends_of(state_dir / "results.sqlite")
    seen = []
    for step in count(1, every):
        copy = shutil.copytree(state_dir, tmp_path / "copies" / str(step))
        is_killed = killed_at(step, partial(restore, backup, copy))
        seen.append(await require_one_whole_history(copy, names, former))
        if not is_killed:
            break
    assert seen == sorted(seen)
    assert set(seen) == {False, True}


@pytest.mark.full
async def test_a_start_that_finishes_a_restore_may_be_killed_at_any_step_too(
    state_dir: Path, tmp_path: Path, backed_up: tuple[Path, list[str]]
) -> None:
    backup, names = backed_up
    former = ends_of(state_dir / "results.sqlite")
    step = next(
        step
        for step in count(1)
        if killed_at(step, partial(restore, backup, shutil.copytree(state_dir, tmp_path / f"to-{step}")))
        and (tmp_path / f"to-{step}" / "restoring").exists()
    )
    for kill in count(1):
        copy = shutil.copytree(tmp_path / f"to-{step}", tmp_path / f"then-{kill}")
        is_killed = killed_at(kill, partial(open_store, copy))
        assert await require_one_whole_history(copy, names, former)
        if not is_killed:
            break
