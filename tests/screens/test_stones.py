"""Gallery, passport and comparison on a running replay: a body that turns, a step of the curve and its stones."""

import re
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Locator, Page, Route, expect
from support.browser import (
    SIZES,
    Watched,
    origin_of,
    reachable_by_tab,
    screenshot,
    until,
    violations,
    watched_page,
)
from support.daemon_process import DaemonProcess
from support.eventually import eventually
from support.extents import first_quick

from screens.conftest import N_STONES
from service import screens

PATIENCE_MS = 300_000
SLOW_RENDERER = re.compile("GPU stall due to ReadPixels")
"""What the browser says of its own way to draw without a graphics card."""
NEEDS_THREE = pytest.mark.skipif(
    not (Path(screens.__file__).parent / "packages/three").exists(), reason="deploy/packages was not run"
)


@pytest.fixture(scope="module")
def replay(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[DaemonProcess]:
    """A daemon that has played a recording to its end and kept all frames: no more stones fall."""
    with DaemonProcess(tmp_path_factory.mktemp("daemon"), recording) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda counts: counts["measured"] == N_STONES)
        eventually(lambda: len(list(daemon.folder.glob("state/**/bundle.tiff"))) == N_STONES)
        yield daemon
        assert daemon.process.poll() is None, daemon.log


@pytest.fixture(scope="module")
def lot(replay: DaemonProcess) -> str:
    """A closed lot with all stones."""
    product = {"title": "11/16", "density_kg_m3": 2850, "lower_mm": 11.2, "upper_mm": 16}
    replay.put("/products/split", product)
    replay.post("/lots", {"lot": "L-7", "product": "split"})
    times = {"since": "2000-01-01T00:00:00Z", "until": "2100-01-01T00:00:00Z"}
    assert replay.post("/lots/L-7/assign", times)["n_assigned"] == N_STONES
    replay.post("/lots/L-7/close", {})
    return "L-7"


@pytest.fixture
def page(watched: Watched) -> Iterator[Page]:
    watched.is_expected = SLOW_RENDERER
    watched.page.set_default_timeout(PATIENCE_MS)
    expect.set_options(timeout=PATIENCE_MS)
    yield watched.page


@pytest.fixture(scope="module")
def stone(replay: DaemonProcess, lot: str) -> str:
    """A measured stone of the lot."""
    return str(replay.get(f"/particles?lot={lot}&outcome=measured&limit=1")["items"][0]["id"])


def address(replay: DaemonProcess, path: str) -> str:
    return origin_of(replay.url("")) + path


def picture(canvas: Locator) -> bytes:
    """Return what is drawn, once it is."""
    canvas.page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return canvas.screenshot()


def n_colours(page: Page) -> int:
    """Return how many different colours the canvas shows."""
    return int(
        page.evaluate(
            """async () => {
              const source = document.querySelector("canvas.body");
              const copy = document.createElement("canvas");
              Object.assign(copy, { width: source.width, height: source.height });
              await new Promise((done) => requestAnimationFrame(done));
              source.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft", cancelable: true }));
              await new Promise((done) => requestAnimationFrame(done)); // drawn within this frame, before it is shown
              const context = copy.getContext("2d");
              context.drawImage(source, 0, 0);
              return new Set(new Uint32Array(context.getImageData(0, 0, copy.width, copy.height).data.buffer)).size;
            }"""
        )
    )


@NEEDS_THREE
def test_a_body_is_drawn_and_turned_by_hand_and_key(page: Page, replay: DaemonProcess, stone: str) -> None:
    page.goto(address(replay, f"/stones/{stone}"))
    canvas = page.locator("canvas.body")
    expect(canvas).to_be_visible()
    assert n_colours(page) > 100  # a shaded body, not an empty canvas
    first = picture(canvas)
    box = canvas.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 200, box["y"] + 150, steps=5)
    page.mouse.up()
    dragged = picture(canvas)
    assert dragged != first
    canvas.focus()
    page.keyboard.press("ArrowRight")
    assert picture(canvas) != dragged


@NEEDS_THREE
@pytest.mark.full
def test_gauges_are_drawn_and_can_be_put_away(page: Page, replay: DaemonProcess, stone: str) -> None:
    page.goto(address(replay, f"/stones/{stone}"))
    canvas = page.locator("canvas.body")
    length_mm = replay.get(f"/particles/{stone}")["length_mm"]
    expect(page.locator(".gauge.length")).to_have_text(f"Length {length_mm:.2f} mm")
    expect(page.locator(".gauge.sieve")).to_be_visible()
    expect(page.locator(".gauge.max_feret")).to_be_hidden()
    for name in ("width", "thickness", "sieve"):
        page.locator(f".switch.{name} input").uncheck()
    shown = picture(canvas)
    page.locator(".switch.length input").uncheck()
    expect(page.locator(".gauge.length")).to_be_hidden()
    assert picture(canvas) != shown


@NEEDS_THREE
@pytest.mark.full
def test_a_body_is_coarse_until_all_of_it_is_asked_for(page: Page, replay: DaemonProcess, stone: str) -> None:
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url) if "mesh.glb" in request.url else None)
    # these stones are too small to have less: another one is seen at first
    other = page.request.get(replay.url("/particles/1/mesh.glb"))
    page.route("**/mesh.glb?detail=preview", lambda route: route.fulfill(response=other))
    page.goto(address(replay, f"/stones/{stone}"))
    canvas = page.locator("canvas.body")
    expect(canvas).to_be_visible()
    assert [url.rpartition("/")[2] for url in asked] == ["mesh.glb?detail=preview"]
    coarse = picture(canvas)
    button = page.get_by_role("button", name="All details of the body")
    button.click()
    expect(button).to_be_hidden()
    assert [url.rpartition("/")[2] for url in asked[1:]] == ["mesh.glb"]
    assert picture(canvas) != coarse


@pytest.mark.parametrize("lack", ["package", "WebGL"])
@pytest.mark.full
def test_without_3d_there_is_a_picture(page: Page, replay: DaemonProcess, stone: str, lack: str) -> None:
    if lack == "package":
        page.route("**/packages.json", lambda route: route.fulfill(json=[]))
    else:
        page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(address(replay, f"/stones/{stone}"))
    shown = page.locator("#body img")
    expect(shown).to_be_visible()
    until(page, "() => document.querySelector('#body img').naturalWidth > 0")
    expect(page.locator("#body .note")).to_contain_text("A picture instead of 3-D")
    assert page.locator("canvas").count() == 0


@pytest.mark.full
def test_the_passport_has_numbers_with_uncertainty_and_standard(
    page: Page, replay: DaemonProcess, stone: str
) -> None:
    page.goto(address(replay, f"/stones/{stone}"))
    record = replay.get(f"/particles/{stone}")
    row = page.locator("[data-measure=length_mm]")
    expect(row).to_contain_text(f"{record['length_mm']:.2f} mm")
    expect(row).to_contain_text(f"± {2 * 2**0.5 * record['surface_sd_mm']:.2f}")
    expect(row).to_contain_text("ASTM D4791")
    ratio = page.locator("[data-measure=corey]")
    expect(ratio).to_contain_text(f"Shape factor{record['corey']:.3f}")
    expect(page.locator("#views figure")).to_have_count(len(record["views"]) + len(record["dropped_views"]))
    page.locator("#views").scroll_into_view_if_needed()
    until(page, "() => document.querySelector('.view svg .stone') !== null")  # its outline
    expect(page.locator("#facts")).to_contain_text("L-7")
    before = page.locator("#neighbours a[rel=prev]")
    expect(before).to_have_attribute("href", re.compile(r"/stones/[0-9a-f]{8}-\d+$"))
    page.goto(address(replay, f"/stones/{stone}?language=de"))
    expect(ratio).to_contain_text("Formfaktor")


@pytest.mark.full
def test_a_pin_holds_until_it_is_taken_away(page: Page, replay: DaemonProcess, lot: str, stone: str) -> None:
    two = replay.get(f"/particles?lot={lot}&outcome=measured&limit=2")["items"]
    other = next(each["id"] for each in two if each["id"] != stone)
    page.goto(address(replay, f"/stones/{other}"))
    page.locator("#pin-reason").fill("the lab checks it")
    page.locator("#pin button").click()
    expect(page.locator("#pin")).to_contain_text("the lab checks it")
    assert replay.get(f"/particles/{other}")["pin_reason"] == "the lab checks it"
    page.locator("#pin button").click()
    expect(page.locator("#pin-reason")).to_be_visible()
    assert replay.get(f"/particles/{other}")["is_pinned"] is False


@pytest.mark.full
def test_in_print_is_a_picture_a_link_and_room_for_the_lab(
    page: Page, replay: DaemonProcess, stone: str
) -> None:
    page.goto(address(replay, f"/stones/{stone}"))
    expect(page.locator("[data-measure=length_mm]")).to_be_visible()
    expect(page.locator("#picture")).to_be_hidden()
    page.emulate_media(media="print")
    expect(page.locator("#picture")).to_be_visible()
    expect(page.locator("#address a")).to_have_text(re.compile(rf"/stones/{stone}$"))
    expect(page.locator("td.box:visible")).to_have_count(4)
    expect(page.locator(".by-hand")).to_be_visible()
    expect(page.locator("#body")).to_be_hidden()
    screenshot(page, "passport-print")


@pytest.mark.full
def test_a_click_on_the_curve_shows_its_stones_and_one_less_moves_the_interval(
    page: Page, replay: DaemonProcess, lot: str
) -> None:
    page.goto(address(replay, f"/gallery?lot={lot}"))
    steps = replay.get(f"/lots/{lot}/gradation")["curve"]
    sieve_mm = max(
        step["sieve_mm"]
        for step in steps
        if replay.get(f"/lots/{lot}/particles?sieve={step['sieve_mm']}")["items"]
    )
    behind = [each["id"] for each in replay.get(f"/lots/{lot}/particles?sieve={sieve_mm}")["items"]]
    page.locator(f"[data-sieve='{sieve_mm:g}']").click()
    expect(page.locator("#tiles li")).to_have_count(len(behind))
    assert page.locator("#tiles li").evaluate_all("(tiles) => tiles.map((e) => e.dataset.id)") == behind
    page.locator("#tiles li button").first.click()
    expect(page.locator("#figures")).to_contain_text("What if only")
    passing = page.locator("#figures tbody tr", has_text=f"Passing {sieve_mm:g} mm").locator(".interval")
    expect(passing).to_have_count(2)
    assert passing.nth(0).inner_text() != passing.nth(1).inner_text()
    assert page.url.endswith(f"without={behind[0]}")
    page.reload()
    expect(page.locator("#tiles li.out")).to_have_count(1)
    page.locator("#tiles li.out button").click()
    expect(page.locator("#figures")).not_to_contain_text("What if only")
    expect(page.locator("#tiles li.out")).to_have_count(0)
    assert "without" not in page.url


@pytest.mark.full
def test_a_filter_is_in_the_address_and_the_list_has_no_end(
    page: Page, recording: Path, tmp_path: Path
) -> None:
    with DaemonProcess(tmp_path, recording, rig='pace = "fast"\nloop = true') as replay:
        replay.hear("READY=1")
        replay.wait_for("/accounting", lambda counts: counts["measured"] > 66)  # more than are shown at once
        replay.put("/acquisition", {"state": "disarmed"})
        _scroll_and_filter(page, replay)


def _scroll_and_filter(page: Page, replay: DaemonProcess) -> None:
    page.goto(address(replay, "/gallery"))
    until(page, "() => document.querySelectorAll('#tiles li').length >= 60")
    page.locator("#list-card").scroll_into_view_if_needed()
    page.evaluate("scrollTo(0, document.body.scrollHeight)")
    until(page, "() => document.querySelectorAll('#tiles li').length > 60")
    ids = page.locator("#tiles li").evaluate_all("(tiles) => tiles.map((e) => e.dataset.id)")
    assert len(ids) == len(set(ids))
    page.locator("[name=min_sieve_size_mm]").fill("400")
    page.locator("[name=min_sieve_size_mm]").blur()
    expect(page.locator("#list-heading")).to_have_text("No stone passes these filters.")
    assert "min_sieve_size_mm=400" in page.url
    page.go_back()
    until(page, "() => document.querySelectorAll('#tiles li').length >= 60")


@pytest.mark.full
def test_any_sieves_make_the_curve_and_wrong_ones_are_refused(
    page: Page, watched: Watched, replay: DaemonProcess, lot: str
) -> None:
    watched.is_expected = re.compile(f"{SLOW_RENDERER.pattern}|status of 422")
    page.goto(address(replay, f"/gallery?lot={lot}&language=de"))
    expect(page.locator("[data-sieve='16']")).to_be_visible()  # the product's
    sieves = page.get_by_label("Andere Siebe")
    sieves.fill("5,6; 13,37; 18")
    sieves.press("Enter")
    expect(page.locator("[data-sieve='13.37']")).to_be_visible()
    assert [each.get_attribute("data-sieve") for each in page.locator("[data-sieve]").all()] == [
        "5.6",
        "13.37",
        "18",
    ]
    assert "sieve_set=5.6%2C13.37%2C18" in page.url
    page.locator("[data-sieve='18']").press("Enter")
    behind = replay.get(f"/lots/{lot}/particles?sieve=18&sieve_set=5.6,13.37,18")["items"]
    expect(page.locator("#tiles li")).to_have_count(len(behind))
    screenshot(page, "gallery-sieves")
    sieves.fill("8 4")
    sieves.press("Enter")
    expect(page.locator("#problem")).to_contain_text("must rise")
    expect(page.locator("#lot-figures")).to_be_hidden()
    page.go_back()
    expect(page.locator("[data-sieve='13.37']")).to_be_visible()
    page.locator("#lot").select_option("")
    expect(sieves).to_be_hidden()
    assert "sieve_set" not in page.url


@pytest.mark.parametrize(
    ("language", "one", "many"), [("en", "1 stone, ", "2 stones, "), ("de", "1 Stein, ", "2 Steine, ")]
)
def test_a_single_stone_is_called_one(
    page: Page, replay: DaemonProcess, language: str, one: str, many: str
) -> None:
    page.goto(address(replay, f"/gallery?language={language}"))
    expect(page.get_by_role("heading").first).to_be_visible()
    told = page.evaluate(
        """async () => {
          const { src } = document.querySelector('script[src*="scripts/"]');
          const { word } = await import(new URL("words.js", src));
          return ["1", 2].map((n) => word("gallery.stones", { n }));
        }"""
    )
    assert [text.startswith(begin) for text, begin in zip(told, (one, many), strict=True)] == [True, True]


@pytest.mark.full
def test_the_largest_stones_of_a_lot_come_first(page: Page, replay: DaemonProcess, lot: str) -> None:
    page.goto(address(replay, f"/gallery?lot={lot}"))
    page.get_by_role("button", name="Largest stones first").click()
    expect(page.locator("#list-heading")).to_contain_text("heaviest stones of the lot")
    expect(page.locator("#conditions")).to_be_hidden()
    heaviest = replay.get(f"/lots/{lot}/particles?limit=60")["items"]
    assert [each["volume_mm3"] for each in heaviest] == sorted(
        (each["volume_mm3"] for each in heaviest), reverse=True
    )
    shown = page.locator("#tiles li").evaluate_all("(tiles) => tiles.map((tile) => tile.dataset.id)")
    assert shown == [each["id"] for each in heaviest]
    page.get_by_role("button", name="All stones of the lot").click()
    expect(page.locator("#list-heading")).to_contain_text("newest first")


@pytest.mark.full
def test_a_lot_is_compared_with_itself(page: Page, replay: DaemonProcess, lot: str) -> None:
    page.goto(address(replay, f"/compare?a={lot}"))
    page.locator("#b").select_option(lot)
    expect(page.locator("#figures")).to_contain_text("The same stones, one by one")
    expect(page.locator("#curves svg polyline.beside").first).to_be_visible()
    differences = page.locator("#figures tbody tr td:last-child").all_inner_texts()
    assert differences and all(re.match(r"–|0\.0+ ", text) for text in differences)


@pytest.mark.parametrize(("size", "theme"), first_quick(product(SIZES, ("dark", "light"))))
def test_axe_core_finds_nothing(
    browser: Browser, replay: DaemonProcess, lot: str, stone: str, size: str, theme: str
) -> None:
    with watched_page(browser, viewport=SIZES[size], color_scheme=theme, locale="de") as watched:
        page = watched.page
        watched.is_expected = SLOW_RENDERER
        page.set_default_timeout(PATIENCE_MS)
        for name, path, ready in (
            ("passport", f"/stones/{stone}", "#facts dd"),
            ("gallery", f"/gallery?lot={lot}", "[data-sieve]"),
            ("compare", f"/compare?a={lot}&b={lot}", "#figures td"),
        ):
            page.goto(address(replay, path))
            page.locator(ready).first.wait_for()
            page.wait_for_load_state("networkidle")
            screenshot(page, f"{name}-{size}-{theme}")
            assert violations(page) == []
        watched.assert_clean()


@pytest.mark.full
def test_all_is_reached_by_keys(page: Page, replay: DaemonProcess, lot: str, stone: str) -> None:
    page.goto(address(replay, f"/gallery?lot={lot}"))
    page.locator("[data-sieve]").first.wait_for()
    page.locator("#tiles li").first.wait_for()
    reached = reachable_by_tab(page)
    steps = page.locator("[data-sieve]").evaluate_all("(steps) => steps.map((e) => e.ariaLabel)")
    assert {*steps, "What if without it", "Clear filters"} <= reached
    curve = replay.get(f"/lots/{lot}/gradation")["curve"]
    unmeasured = {f"{step['sieve_mm']:g}" for step in curve if step["passing_percent"]["value"] is None}
    ends = [set(label.partition(" mm:")[0].split(" to ")) for label in steps]
    assert any(each & unmeasured for each in ends)  # of the smallest sieves
    assert ["not measured" in label for label in steps] == [bool(each & unmeasured) for each in ends]


@pytest.mark.full
def test_a_comparison_says_that_its_lots_are_still_loading(
    page: Page, replay: DaemonProcess, lot: str
) -> None:
    held: list[Route] = []

    def hold(route: Route) -> None:
        held.append(route)

    page.route("**/api/v1/lots", hold)
    page.goto(address(replay, "/compare"))
    choice = page.locator("#a")
    expect(choice).to_be_visible()
    expect(choice).to_have_text("The list of lots is loading …")
    (route,) = held
    route.continue_()
    expect(choice).to_contain_text(lot)
