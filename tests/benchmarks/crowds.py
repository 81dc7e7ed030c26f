"""Clients that ask a daemon in a closed loop: the crowds of `readers.py`, which runs it with the lowest priority.

Run: .venv/bin/python tests/benchmarks/crowds.py polls|pages|cheap|lots|rude|viewers|browsers URL SECONDS
"""

import asyncio
import json
import sys
import time
from collections import defaultdict
from collections.abc import AsyncIterator, Awaitable, Callable, Generator
from contextlib import AsyncExitStack, asynccontextmanager
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlsplit

import numpy as np
from playwright.async_api import Page, async_playwright
from viewers import Viewer

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.browser import EXECUTABLE, FLAGS, SIZES

N_WITH_MESH = 1000
"""Results in the store before the run that have a mesh: a page of the greatest size."""
CLIENTS = {"polls": 200, "pages": 4, "cheap": 16, "lots": 1, "rude": 71, "viewers": 20, "browsers": 205}
"""Number of clients of each crowd."""
N_STREAMS, N_STALLED = 20, 50
"""Clients among the rude ones that read a stream, and that do not read."""
N_PAGES = 5
"""Operator's pages, tabs of one headless Chromium, that are open beside the long polls of `browsers`."""
LAST = f"""#!/bin/sh
[ ! -w /proc/self/autogroup ] || echo 19 > /proc/self/autogroup
exec {EXECUTABLE} "$@"
"""
"""Starts the browser: it has a session of its own, to which Linux gives its share whatever the niceness (sched(7))."""
OWN_ADDRESS = "127.0.0.2"
"""Address of all clients but browsers, as one address may not have all connections."""
LOOK_S = 0.5
TILES = """() => {
  const tiles = [...document.querySelectorAll("#newest li.measured")];
  return [tiles.length, tiles.filter((tile) => tile.querySelector("img")?.naturalWidth > 0).length];
}"""
FIRST_PAINT_MS = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime"
BODY_BYTES = 100_000_000
PIECE = b" " * 65_536
Questions = Generator[str, bytes, None]
"""What a client asks for, one after the other, sent the answer of each: a path, or method, path and body."""


async def be(crowd: str, url: str, seconds: float) -> None:
    """Be a crowd of clients in a closed loop; print how many answers of which status they got, and how much."""
    statuses: dict[int, int] = {}
    n_bytes = 0
    longest_s = 0.0

    async def rude(number: int) -> None:
        nonlocal n_bytes
        address = urlsplit(url)
        path, kind = (f"{address.path}/results/stream", "streams") if number < N_STREAMS else ("", "bodies")
        while True:
            reader, writer = await asyncio.open_connection(address.hostname, address.port)
            try:
                if N_STREAMS <= number < N_STREAMS + N_STALLED:
                    path, kind = f"{address.path}/results?after=0&limit=1000", "stalled"
                    writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
                    COUNTED[f"{kind} begun"] += 1
                    await asyncio.sleep(seconds)
                elif number < N_STREAMS:
                    writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
                    while piece := await reader.read(65_536):
                        COUNTED["events"] += piece.count(b"\nid: ") + piece.startswith(b"id: ")
                        n_bytes += len(piece)
                else:
                    head = f"POST {address.path}/lots HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json"
                    writer.write(f"{head}\r\nContent-Length: {BODY_BYTES}\r\n\r\n".encode())
                    for _ in range(BODY_BYTES // len(PIECE)):
                        writer.write(PIECE)
                        await writer.drain()
            except OSError:  # closed, as it must be
                pass
            finally:
                COUNTED[f"{kind} ended"] += 1
                writer.close()
            await asyncio.sleep(0.1)

    @asynccontextmanager
    async def asking() -> AsyncIterator[Callable[[str], Awaitable[bytes]]]:
        """Connect, and return what asks and counts."""
        reader, writer = await asyncio.open_connection(
            urlsplit(url).hostname, urlsplit(url).port, local_addr=(OWN_ADDRESS, 0)
        )

        async def answer(question: str) -> bytes:
            nonlocal n_bytes, longest_s
            began_s = time.monotonic()
            status, content = await ask(reader, writer, urlsplit(url).path, question)
            longest_s = max(longest_s, time.monotonic() - began_s)
            statuses[status] = statuses.get(status, 0) + 1
            n_bytes += len(content)
            return content

        try:
            yield answer
        finally:
            writer.close()

    async def client(number: int) -> None:
        async with asking() as answer:
            questions = QUESTIONS[crowd](number)
            question = next(questions)
            while True:
                question = questions.send(await answer(question))

    async def viewer(number: int) -> None:
        async with asking() as answer:
            await Viewer(url, answer, TIMES_S).watch()

    async def operator(number: int) -> None:
        """Look at the operator's page, of which the first `N_PAGES` numbers have one; the others ask for results."""
        await (look(pages[number], url) if number < N_PAGES else client(number))

    kinds = {"rude": rude, "viewers": viewer, "browsers": operator}
    pages: list[Page] = []
    try:
        async with asyncio.timeout(seconds), AsyncExitStack() as open_browser, asyncio.TaskGroup() as clients:
            if crowd == "browsers":
                pages += await opened_pages(open_browser)
            for number in range(CLIENTS[crowd]):
                clients.create_task(kinds.get(crowd, client)(number))
    except TimeoutError:
        pass
    counts = ", ".join(
        [
            *(f"{n} x {status}" for status, n in sorted(statuses.items())),
            *(f"{n} {what}" for what, n in COUNTED.items()),
        ]
    )
    told = "".join(
        f"; {what}: first {took_s[0]:.2f}, median {np.median(took_s):.2f}, longest {max(took_s):.2f} s"
        for what, took_s in TIMES_S.items()
    )
    sys.stdout.write(f"{counts}, {n_bytes / 1e6:.0f} MB, within {longest_s:.1f} s{told}\n")


async def opened_pages(open_browser: AsyncExitStack) -> list[Page]:
    """Return tabs of one browser, which is closed with `open_browser`."""
    playwright = await open_browser.enter_async_context(async_playwright())
    last = Path(open_browser.enter_context(TemporaryDirectory())) / "chromium"
    last.write_text(LAST, encoding="utf-8")
    last.chmod(0o755)
    browser = await playwright.chromium.launch(executable_path=last, args=FLAGS)
    open_browser.push_async_callback(browser.close)
    return [await browser.new_page(viewport=SIZES["desktop"]) for _ in range(N_PAGES)]


async def look(page: Page, url: str) -> None:
    """Look at the operator's page again and again, and count the newest stones with their picture and all of them."""
    await page.goto("{0.scheme}://{0.netloc}/".format(urlsplit(url)))
    await page.wait_for_selector("#newest li")  # what was painted first was painted before
    TIMES_S["first paint"].append(await page.evaluate(FIRST_PAINT_MS) / 1000)
    while True:
        await asyncio.sleep(LOOK_S)
        n_tiles, n_pictures = await page.evaluate(TILES)
        COUNTED["tiles"] += n_tiles
        COUNTED["tiles with picture"] += n_pictures


async def ask(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, base: str, question: str
) -> tuple[int, bytes]:
    """Return status and body of the answer."""
    method, path, body = ("GET", question, "") if question.startswith("/") else question.split(" ", 2)
    head = f"{method} {base}{path} HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json"
    writer.write(f"{head}\r\nContent-Length: {len(body)}\r\n\r\n{body}".encode())
    head = (await reader.readuntil(b"\r\n\r\n")).decode()
    fields = dict(line.lower().split(": ", 1) for line in head.splitlines()[1:] if line)
    return int(head.split()[1]), await reader.readexactly(int(fields["content-length"]))


def long_polls(number: int) -> Questions:
    after = json.loads((yield "/results?after=0&limit=1"))["last_seq"]
    while True:
        after = json.loads((yield f"/results?after={after}&limit=100&wait_s=30"))["next_after"]


def big_pages(number: int) -> Questions:
    for turn in count():
        if turn % 2:
            yield f"/results?after={turn % 7}&limit=1000"
        else:
            yield "/particles?limit=1000"
        for preview in range(5):
            yield f"/particles/{10 + (turn * 20 + number * 5 + preview) % N_WITH_MESH}/preview.png"


def cheap_answers(number: int) -> Questions:
    while True:
        yield f"/particles/{10 + number}"
        yield "/particles/10/preview.png"
        yield "/results?after=100&limit=1"


def lots(number: int) -> Questions:
    yield 'PUT /products/bench {"title": "bench", "density_kg_m3": 2700}'
    for turn in count():
        began_s = time.monotonic()
        yield f'POST /lots {{"lot": "L{turn}", "product": "bench"}}'
        if turn == 0:
            yield 'POST /lots/L0/assign {"since": "2000-01-01T00:00:00Z", "until": "2100-01-01T00:00:00Z"}'
        yield f"POST /lots/L{turn}/close {{}}"
        yield "/lots/L0/report.html"
        TIMES_S["opened, closed, reported as HTML"].append(time.monotonic() - began_s)
        began_s = time.monotonic()
        yield "/lots/L0/report.pdf"
        TIMES_S["as PDF"].append(time.monotonic() - began_s)


QUESTIONS = {
    "polls": long_polls,
    "pages": big_pages,
    "cheap": cheap_answers,
    "lots": lots,
    "browsers": long_polls,
}
"""What a client of each crowd asks for, one after the other."""
TIMES_S: dict[str, list[float]] = defaultdict(list)
"""What a client noted."""
COUNTED: dict[str, int] = defaultdict(int)
"""What clients counted: what became of connections, and what a page had."""


if __name__ == "__main__":
    asyncio.run(be(sys.argv[1], sys.argv[2], float(sys.argv[3])))
