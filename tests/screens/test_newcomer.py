"""The six tasks of a shift are found by roles, labels and visible words alone, as a newcomer finds them."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

import pytest
from playwright.sync_api import Browser, Page, Route, expect
from support.browser import SIZES, origin_of, watched_page
from support.daemon_process import DaemonProcess

from screens.conftest import DIM
from screens.test_lots_page import PRODUCT

PATIENCE_MS = 300_000
SIEVES_MM = (8, 11.2, 16, 22.4)
SIEVING = "Sieb\tRückstand g\n22,4\t0\n16\t120,5\n11,2\t850,2\n8\t25,1\nSchale\t4,2"


class Newcomer:
    """Drives a page by what it shows, and counts inputs and page loads."""

    def __init__(self, page: Page, start: str) -> None:
        self.page = page
        self._start = start
        self.n_inputs = self.n_loads = 0
        page.on("domcontentloaded", self._note_load)

    def _note_load(self, _: object) -> None:
        self.n_loads += 1

    @contextmanager
    def task(self, name: str, *, inputs: int, loads: int) -> Iterator[None]:
        """Begin at the operator's page; fail unless the task took so many inputs and page loads after that."""
        self.page.goto(self._start)
        expect(self.page.get_by_role("heading", name="Misst")).to_be_visible()
        self.n_inputs = self.n_loads = 0
        yield
        assert (self.n_inputs, self.n_loads) == (inputs, loads), name

    def press(self, role: Literal["button", "link"], name: str) -> None:
        """Press what has a name, of several the first: the newest."""
        self.n_inputs += 1
        self.page.get_by_role(role, name=name).first.click()

    def scan(self, code: str) -> None:
        """Type as a keyboard scanner does, wherever the focus is."""
        self.n_inputs += 1
        self.page.keyboard.type(code)
        self.page.keyboard.press("Enter")

    def paste(self, label: str, text: str) -> None:
        self.n_inputs += 1
        self.page.get_by_label(label).fill(text)

    def sees_open(self, lot: str, product: str) -> None:
        card = self.page.get_by_role("region", name="Offenes Los")
        for text in (lot, f"{product}, Version 1"):
            expect(card.get_by_text(text, exact=True)).to_be_in_viewport()

    def sees(self, text: str | re.Pattern[str]) -> None:
        expect(self.page.get_by_text(text).first).to_be_in_viewport()


@pytest.fixture
def newcomer(browser: Browser, replay: DaemonProcess) -> Iterator[Newcomer]:
    """At the operator's page of a plant of two products, one camera of which sees less light."""
    for name, title in (("basalt-11-22", "Basalt 11/22"), ("basalt-8-16", "Basalt 8/16")):
        replay.put(f"/products/{name}", {**PRODUCT, "title": title, "sieve_set": SIEVES_MM})
    replay.post("/lots", {"lot": "L-1206", "product": "basalt-8-16"})
    replay.post("/lots/L-1206/close?wait_s=60", {})
    with watched_page(browser, viewport=SIZES["tablet"], locale="de-DE") as watched:
        watched.page.set_default_timeout(PATIENCE_MS)
        expect.set_options(timeout=PATIENCE_MS)
        yield Newcomer(watched.page, origin_of(replay.url("")))
        watched.assert_clean()


def keep(route: Route) -> None:
    """Show how a file begins in the place of the browser's viewer, which asks for its own parts."""
    route.fulfill(
        body=f"{route.fetch().body()[:4].decode()} of {route.request.url}", content_type="text/plain"
    )


@pytest.mark.full  # the pages of a shift, each loaded anew
def test_a_newcomer_does_the_six_tasks_of_a_shift(newcomer: Newcomer, replay: DaemonProcess) -> None:
    page = newcomer.page
    with newcomer.task("open a lot by its code", inputs=2, loads=1):
        newcomer.press("link", "Los öffnen, Code scannen")
        newcomer.sees("Code scannen, oder tippen und Enter")
        newcomer.scan("L-1207")
        newcomer.sees_open("L-1207", "basalt-8-16")  # of the lot before
    assert replay.get("/lots/L-1207")["product"] == "basalt-8-16"

    with newcomer.task("change the product", inputs=3, loads=1):
        newcomer.press("link", "Produkt wechseln")
        newcomer.press("button", "Produkt wechseln …")
        newcomer.sees("Los L-1207 wird mit dem bisher Gefallenen abgeschlossen")
        newcomer.scan("L-1208")
        newcomer.sees_open("L-1208", "basalt-11-22")
    assert replay.get("/lots/L-1208")["product"] == "basalt-11-22"
    assert replay.get("/lots/L-1207")["state"] in ("closing", "closed")

    with newcomer.task("find the camera that sees badly", inputs=0, loads=0):
        newcomer.sees(re.compile(f"^Kamera {DIM} .*Staub, Licht"))

    replay.wait_for("/lots/L-1208", lambda lot: lot["n_stones"] > 3)
    with newcomer.task("enter a sieving", inputs=5, loads=2):
        newcomer.press("link", "Los abschließen")
        newcomer.press("link", "Labor")
        newcomer.paste("Tabelle, wie aus einer Tabellen", SIEVING)
        newcomer.press("button", "Lesen und vergleichen")
        expect(page.get_by_role("button", name="Speichern")).to_be_in_viewport()
        newcomer.press("button", "Speichern")
        newcomer.sees("Die Siebung von Los L-1208 ist gespeichert.")

    with newcomer.task("close the lot", inputs=3, loads=1):
        newcomer.press("link", "Los abschließen")
        newcomer.press("button", "Abschließen …")
        newcomer.press("button", "Los abschließen")
        done = page.get_by_role("dialog", name="Los L-1208 ist abgeschlossen")
        expect(done.get_by_text(re.compile("entspricht|zu wenige Steine|unentschieden"))).to_be_visible()
        expect(done.get_by_role("link", name="PDF")).to_be_visible()

    page.route("**/report.pdf?*", keep)
    with newcomer.task("the report", inputs=1, loads=1):
        newcomer.press("link", "Bericht")
        newcomer.sees(re.compile("^%PDF of .*/lots/L-1208/report.pdf"))

    with newcomer.task("the shift sheet", inputs=1, loads=1):
        newcomer.press("link", "Schichtblatt")
        expect(page.get_by_role("button", name="Drucken")).to_be_in_viewport()
        newcomer.sees(re.compile("^Schicht vom "))
    printed = page.request.get(page.get_by_role("link", name="Als PDF").evaluate("(link) => link.href"))
    assert printed.body()[:4] == b"%PDF"
