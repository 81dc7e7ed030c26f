"""What deploy/watch.py says of a key that is not right, of another store, and at the end."""

import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from support.fake_feed import FakeFeed, serving

WATCH = Path(__file__).parents[3] / "deploy" / "watch.py"


@contextmanager
def watching(feed: FakeFeed, *options: str | Path) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, WATCH, feed.url, *options]
    watch = subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    try:
        yield watch
    finally:
        watch.kill()
        watch.communicate()


def read_until(watch: subprocess.Popen[str], pattern: str) -> str:
    """Return the next line that matches."""
    assert watch.stdout is not None
    while not re.search(pattern, line := watch.stdout.readline()):
        assert line, "it has ended"
    return line


def test_a_wrong_key_is_told_and_another_one_taken(tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_text("wrong")
    with serving(FakeFeed(last_seq=2, key="right")) as feed, watching(feed, "--key-file", key) as watch:
        read_until(watch, "^401 unauthorized")
        key.write_text("right")
        read_until(watch, "^answered again")
        read_until(watch, "^ +2  000002 ")


def test_the_end_says_which_triggers_are_no_stones() -> None:
    ended = {
        "/accounting": {"triggers": 3, "measured": 3, "rejected": 0, "lost": 0, "in_progress": 0},
        "/acquisition": {"state": "disarmed"},
    }
    with serving(FakeFeed(last_seq=3, balls={2}, documents=ended)) as feed, watching(feed, "--once") as watch:
        read_until(watch, "^3 triggers = 3 measured")
        told = read_until(watch, "stones")
        assert watch.wait() == 0
    assert told == "2 of them are stones; 1 is a ball as calibrations use, which no lot counts\n"


def test_another_store_is_told_and_printed_from_its_beginning() -> None:
    with serving(FakeFeed(last_seq=3)) as feed, watching(feed) as watch:
        read_until(watch, "^ +3  000003 ")
        feed.instance_id, feed.last_seq = "bbbbbbbb", 2
        read_until(watch, "^another store .*bbbbbbbb")
        read_until(watch, "^ +1  000001 ")
        read_until(watch, "^ +2  000002 ")
