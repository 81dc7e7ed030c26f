import asyncio
import os
import resource
import shlex
import shutil
import socket
import subprocess
import sys
import uuid
from pathlib import Path
from subprocess import PIPE

import pytest
from support.eventually import PATIENCE_S

from service.base.systemd import ServiceManager, feed_watchdog, service_manager
from service.processing.left_bundles import MAX_DEATHS

UNIT = Path(__file__).parents[4] / "systemd/stonefall.service"
BRIDGE = UNIT.with_name("stonefall-bridge.service")


@pytest.mark.parametrize("kind", ["path", "abstract"])
def test_notifications_arrive_as_one_datagram(kind: str, tmp_path: Path):
    address = str(tmp_path / "notify") if kind == "path" else f"@stonefall-{uuid.uuid4()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(address.replace("@", "\0", 1))
        listener.settimeout(PATIENCE_S)
        service_manager({"NOTIFY_SOCKET": address}, pid=1).notify("READY=1", "STATUS=armed, 16 cameras")
        assert listener.recv(4096) == b"READY=1\nSTATUS=armed, 16 cameras"


def test_a_manager_that_does_not_listen_is_no_failure(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    ServiceManager().notify("READY=1")
    assert not caplog.records
    ServiceManager(address=str(tmp_path / "gone")).notify("READY=1")
    assert "READY=1" in caplog.text


def test_without_a_free_descriptor_notifying_fails_and_the_daemon_does_not(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    manager = ServiceManager(address=str(tmp_path / "notify"))
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, limits[1]))
    try:
        manager.notify("WATCHDOG=1")
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert "was not notified: [Errno 24] Too many open files" in caplog.text


async def test_the_watchdog_is_fed_by_progress_alone(tmp_path: Path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.setblocking(False)
        manager = ServiceManager(address=str(tmp_path / "notify"), watchdog_s=0.003)
        late: list[str] = []
        stopping = asyncio.Event()
        feeding = asyncio.create_task(feed_watchdog(manager, lambda: late, lambda: "armed", stopping))
        assert await heard(listener) == "WATCHDOG=1\nSTATUS=armed"
        stopping.set()
        while "EXTEND_TIMEOUT_USEC=15000000" not in await heard(listener):
            pass
        late.append("processing")
        await asyncio.sleep(0.01)
        while unheard(listener):
            pass
        with pytest.raises(TimeoutError):
            await heard(listener, timeout_s=0.1)
        late.clear()
        assert "WATCHDOG=1" in await heard(listener)
        feeding.cancel()


async def heard(listener: socket.socket, timeout_s: float = 5) -> str:
    async with asyncio.timeout(timeout_s):
        return (await asyncio.get_running_loop().sock_recv(listener, 4096)).decode()


def unheard(listener: socket.socket, size: int = 4096) -> bytes:
    try:
        return listener.recv(size)
    except BlockingIOError:
        return b""


@pytest.mark.parametrize(
    ("environ", "watchdog_s"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "20000000"}, 20.0),
        ({"WATCHDOG_USEC": "20000000", "WATCHDOG_PID": "42"}, 20.0),
        ({"WATCHDOG_USEC": "20000000", "WATCHDOG_PID": "43"}, None),
    ],
)
def test_the_watchdog_is_ours_only_if_it_names_us(environ: dict[str, str], watchdog_s: float | None):
    assert service_manager(environ, pid=42).watchdog_s == watchdog_s


PROGRAM = """
import os, logging, sys
from pathlib import Path
from service.base.log_level import LogLevel
from service.base.log_lines import SESSION
from service.base.systemd import configure_logging, use_level
status = os.fstat(2)
journal = {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino + OFFSET}"}
configure_logging(journal, LogLevel.INFO, Path(sys.argv[1]))
"""


def logged(lines: str, journal: Path, offset: int = 0) -> str:
    """Run lines of Python after the log was configured; return what is on stderr."""
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM.replace("OFFSET", str(offset)) + lines, journal],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": str(UNIT.parents[1])},
    )
    return run.stderr


def test_priorities_are_written_only_when_the_journal_reads_stderr(tmp_path: Path):
    line = "logging.getLogger('x').warning('dust\\nagain')"
    assert logged(line, tmp_path / "none") == "<4>x: dust\n<4>again\n"
    assert "WARNING x: dust" in logged(line, tmp_path / "none", offset=1)


def entries(listener: socket.socket) -> list[dict[str, str]]:
    """Return the entries sent to the journal, field by field (systemd, Native Journal Protocol)."""
    found = []
    while datagram := unheard(listener, 1 << 20):
        fields = {}
        while datagram:
            head, _, datagram = datagram.partition(b"\n")
            name, is_text, value = head.partition(b"=")
            if not is_text:
                size = int.from_bytes(datagram[:8], "little")
                value, datagram = datagram[8 : 8 + size], datagram[9 + size :]
            fields[name.decode()] = value.decode()
        found.append(fields)
    return found


def test_the_journal_gets_fields_by_which_a_stone_is_followed(tmp_path: Path):
    """`journalctl STONEFALL_STONE=7-00000042`: from the gate to the result."""
    lines = """
log = logging.getLogger("service.x")
log.debug("not at this level bundle=00000041")
use_level(LogLevel.DEBUG)
log.warning("before the first session camera=c03: a=b")
SESSION.set(7)
log.debug("the beam closed trigger=3 bundle=00000042")
log.debug("no frame: %s camera=%s bundle=%s", "late", "c05", "00000042")
log.error("trigger lost: why session=6 bundle=00000009\\nMESSAGE\\nPRIORITY=0")
log.debug("measured seq=5 stone_id=abcd-00000005 session=7 bundle=00000042")
log.info("x" * 1_000_000)
"""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "journal"))
        listener.setblocking(False)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        beside = logged(lines, tmp_path / "journal")
        before, *followed = entries(listener)
    assert before["STONEFALL_CAMERA"] == "c03"
    assert before.keys() == {"PRIORITY", "SYSLOG_IDENTIFIER", "LOGGER", "MESSAGE", "STONEFALL_CAMERA"}
    assert [entry["STONEFALL_STONE"] for entry in followed] == [
        "7-00000042",
        "7-00000042",
        "6-00000009",
        "7-00000042",
    ]
    gate, frame, lost, result = followed
    assert (gate["STONEFALL_TRIGGER"], gate["STONEFALL_BUNDLE"], gate["PRIORITY"]) == ("3", "00000042", "7")
    assert (frame["STONEFALL_CAMERA"], frame["MESSAGE"]) == (
        "c05",
        "service.x: no frame: late camera=c05 bundle=00000042",
    )
    assert (lost["STONEFALL_SESSION"], lost["PRIORITY"]) == ("6", "3")
    assert lost["MESSAGE"].endswith("\nMESSAGE\nPRIORITY=0")
    assert result["STONEFALL_STONE_ID"] == "abcd-00000005"
    assert beside.startswith("<6>service.x: xxx")  # too long for a datagram
    assert len(beside) > 1_000_000


def test_whoever_does_not_read_the_log_holds_up_nothing():
    """A journal that hung stopped the daemon with the line that filled its pipe; at its end it waited for ever."""
    program = (
        "import logging; from service.base.systemd import configure_logging; configure_logging({}, 'info');"
        "[logging.getLogger('x').warning('line %d', i) for i in range(40_000)];"
        "print('written', flush=True);"
        "input()"
    )
    environment = os.environ | {"PYTHONPATH": str(UNIT.parents[1])}
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=PIPE, stdout=PIPE, stderr=PIPE, text=True, env=environment
    ) as run:
        assert run.stdin is not None and run.stdout is not None and run.stderr is not None
        assert run.stdout.readline() == "written\n"
        run.stdin.write("\n")
        run.stdin.close()
        written = run.stderr.read()
    assert run.returncode == 0
    assert written.splitlines()[0].endswith("line 0")
    assert "lines of the log are lost: they were not read in time" in written


def test_the_end_does_not_wait_for_who_reads_no_log():
    program = (
        "import logging; from service.base.systemd import configure_logging; configure_logging({}, 'info');"
        "[logging.getLogger('x').warning('line %d', i) for i in range(9_000)]"
    )
    environment = os.environ | {"PYTHONPATH": str(UNIT.parents[1])}
    with subprocess.Popen([sys.executable, "-c", program], stderr=PIPE, env=environment) as run:
        assert run.wait(PATIENCE_S) == 0


def systemd_tool(name: str) -> str:
    """Path of a command of the apt package `systemd`, which the gate installs."""
    path = shutil.which(name)
    if path is None and "CI" not in os.environ:
        pytest.skip(f"{name} is not installed")
    assert path is not None, f"{name} is missing: apt-get install systemd"
    return path


def test_the_unit_is_valid_and_hardened(tmp_path: Path):
    unit = tmp_path / UNIT.name
    # the release folder exists on the plant's machine only
    unit.write_text(UNIT.read_text().replace("/opt/stonefall/current/bin/stonefall", "/bin/true"))
    alarm = tmp_path / "stonefall-alarm.service"
    shutil.copyfile(UNIT.with_name(alarm.name), alarm)
    drop_in = tmp_path / f"{UNIT.name}.d/networks.conf"
    drop_in.parent.mkdir()
    shutil.copyfile(UNIT.with_name("stonefall-networks.conf"), drop_in)
    analyze = systemd_tool("systemd-analyze")
    verified = subprocess.run([analyze, "verify", unit, alarm], capture_output=True, text=True)
    assert (verified.returncode, verified.stdout + verified.stderr) == (0, "")
    subprocess.run(
        [analyze, "security", "--offline=true", "--threshold=20", unit], check=True, capture_output=True
    )


def test_the_unit_of_the_bridge_is_valid_and_hardened(tmp_path: Path):
    unit = tmp_path / BRIDGE.name
    unit.write_text(BRIDGE.read_text().replace("/opt/stonefall/current/bin/stonefall", "/bin/true"))
    analyze = systemd_tool("systemd-analyze")
    verified = subprocess.run([analyze, "verify", unit], capture_output=True, text=True)
    assert (verified.returncode, verified.stdout + verified.stderr) == (0, "")
    subprocess.run(
        [analyze, "security", "--offline=true", "--threshold=20", unit], check=True, capture_output=True
    )
    found = settings_of(BRIDGE)
    assert found["Restart"] == "always"
    assert (found["User"], found["StateDirectory"]) == ("stonefall-bridge", "stonefall-bridge")
    assert (found["IPAddressDeny"], found["IPAddressAllow"]) == ("any", "localhost")


def settings_of(path: Path) -> dict[str, str]:
    """Return the settings of a unit; of those given twice the last."""
    return dict(
        line.split("=", 1) for line in path.read_text().splitlines() if "=" in line and line[0] != "#"
    )


def test_the_unit_keeps_the_spool_bounds_memory_and_lets_nothing_out():
    unit = settings_of(UNIT)
    assert unit["RuntimeDirectoryPreserve"] == "restart"
    assert unit["MemoryMax"].endswith("G")
    assert unit["OOMPolicy"] == "continue"
    assert (unit["IPAddressDeny"], unit["IPAddressAllow"]) == ("any", "localhost")
    assert UNIT.with_name(unit["OnFailure"]).exists()
    # the daemon that gives a bundle up, after it ended so many others, must still be started
    assert int(unit["StartLimitBurst"]) > MAX_DEATHS


def test_when_systemd_gives_up_a_line_says_so(tmp_path: Path):
    command = settings_of(UNIT.with_name("stonefall-alarm.service"))["ExecStart"]
    shell, option, script = shlex.split(command.replace("$$", "$").replace("%%", "%"))
    environment = {
        "STATE_DIRECTORY": str(tmp_path),
        "MONITOR_UNIT": "stonefall.service",
        "MONITOR_SERVICE_RESULT": "exit-code",
        "MONITOR_EXIT_STATUS": "1",
    }
    for _ in range(2):
        subprocess.run([shell, option, script], check=True, env=os.environ | environment)
    lines = (tmp_path / "alarm.txt").read_text().splitlines()
    assert len(lines) == 2
    assert lines[0].partition(" ")[2].startswith("stonefall.service failed (exit-code, status 1)")


def test_account_and_folders_are_made_as_the_unit_expects(tmp_path: Path):
    snippets = UNIT.parent
    (tmp_path / "etc").mkdir()
    sysusers = systemd_tool("systemd-sysusers")
    subprocess.run([sysusers, f"--root={tmp_path}", snippets / "stonefall.sysusers"], check=True)
    assert "stonefall:" in (tmp_path / "etc/passwd").read_text()
    groups = (tmp_path / "etc/group").read_text().splitlines()
    (members,) = (line.rpartition(":")[2].split(",") for line in groups if line.startswith("dialout:"))
    assert members == ["stonefall", "stonefall-bridge"]
    tmpfiles = systemd_tool("systemd-tmpfiles")
    if os.geteuid() == 0:
        subprocess.run(
            [tmpfiles, f"--root={tmp_path}", "--create", snippets / "stonefall.tmpfiles"], check=True
        )
        folder = (tmp_path / "etc/stonefall").stat()
        assert folder.st_mode & 0o777 == 0o750
