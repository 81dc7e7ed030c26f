"""The pages and their files, as a browser gets them."""

import gzip
import posixpath
import re
from urllib.parse import urljoin, urlsplit

import httpx
import pytest
from support.rest import FakeControl

from service.base.status import Ne107
from service.lots.plant import PlantSettings
from service.web.routes.screens import PAGES, POLICY, ROOT, installed_screens

HOST = "http://127.0.0.1:8080"


@pytest.mark.parametrize("address", PAGES)
async def test_a_page_is_asked_for_again_and_allows_this_host_alone(
    client: httpx.AsyncClient, address: str
) -> None:
    page = await client.get(HOST + address)
    assert page.status_code == 200 and page.headers["Content-Type"] == "text/html; charset=utf-8"
    assert page.headers["Cache-Control"] == "no-cache"
    assert page.headers["Content-Security-Policy"] == POLICY
    again = await client.get(HOST + address, headers={"If-None-Match": page.headers["ETag"]})
    assert again.status_code == 304 and again.content == b""
    assert not re.search(r"https?://|\son\w+=|<script>|\{\{", page.text)


@pytest.mark.parametrize("prefix", ["", "/stonefall", "/plant/rig-2"])
@pytest.mark.parametrize("address", PAGES)
async def test_all_that_a_page_names_is_there_for_ever(
    client: httpx.AsyncClient, address: str, prefix: str
) -> None:
    """Whatever a proxy has in front of the path of a page, its names lead below that."""
    page = await client.get(HOST + address)
    names = re.findall(r'(?:src|href)="(?!#|data:)([^"]+)"', page.text)
    paths = [urlsplit(urljoin(HOST + prefix + address, name)).path for name in names]
    assert all(path.startswith(f"{prefix}/") for path in paths)
    own = [path.removeprefix(prefix) for path in paths]
    assert {"/", "/lots", "/api/v1/docs"} <= set(own)
    for name in own:
        found = await client.get(HOST + name)
        assert found.status_code == 200, name
        if not name.startswith(ROOT):
            continue
        assert found.headers["Cache-Control"] == "public, max-age=31536000, immutable"
        assert found.headers["X-Content-Type-Options"] == "nosniff"


def test_all_modules_that_a_script_imports_are_there() -> None:
    files = installed_screens().files
    scripts = {path: file.content.decode() for path, file in files.items() if path.startswith("scripts/")}
    assert scripts
    for path, text in scripts.items():
        for name in re.findall(r'^import .*?"(.+?)";$|^\} from "(.+?)";$', text, re.MULTILINE):
            assert posixpath.normpath(f"{posixpath.dirname(path)}/{''.join(name)}") in files, (path, name)


@pytest.mark.parametrize("address", PAGES)
def test_a_page_names_all_its_scripts_at_once(address: str) -> None:
    shown = installed_screens()
    names = re.findall(r'"modulepreload" href="\S+/(scripts/\S+)"', shown.pages[PAGES[address].name])
    assert names[0] == f"scripts/{PAGES[address].name}.js" and len(names) == len(set(names))
    for path in names:
        for name in re.findall(
            r'^import .*? from "(.+?)";$', shown.files[path].content.decode(), re.MULTILINE
        ):
            assert posixpath.normpath(f"{posixpath.dirname(path)}/{name}") in names, (path, name)


async def test_a_file_is_compressed_for_who_takes_it(client: httpx.AsyncClient) -> None:
    name = f"{HOST}{ROOT}/{installed_screens().version}/styles/base.css"
    plain = await client.get(name, headers={"Accept-Encoding": "identity"})
    packed = await client.get(name, headers={"Accept-Encoding": "gzip"})
    assert "Content-Encoding" not in plain.headers and packed.headers["Content-Encoding"] == "gzip"
    assert packed.content == plain.content  # the client has unpacked it
    assert int(packed.headers["Content-Length"]) < len(plain.content) / 2
    assert gzip.decompress(installed_screens().files["styles/base.css"].gzipped) == plain.content


@pytest.mark.parametrize(
    "path",
    [
        "0000000000000000/styles/base.css",
        "VERSION/styles/none.css",
        "VERSION/pages/operator.html",
        "VERSION/__init__.py",
        "VERSION/..%2f..%2fcli.py",
    ],
)
async def test_nothing_else_is_served(client: httpx.AsyncClient, path: str) -> None:
    answer = await client.get(f"{HOST}{ROOT}/{path.replace('VERSION', installed_screens().version)}")
    assert answer.status_code == 404
    assert answer.headers["Content-Type"] == "application/problem+json"


async def test_an_address_that_is_not_there_is_a_page_for_people_and_a_problem_for_clients(
    client: httpx.AsyncClient,
) -> None:
    browsers = {"Accept": "text/html,application/xhtml+xml,*/*;q=0.8"}
    page = await client.get(HOST + "/nowhere", headers=browsers)
    assert page.status_code == 404 and page.headers["Content-Type"] == "text/html; charset=utf-8"
    assert page.headers["Content-Security-Policy"] == POLICY and 'data-word="missing.title"' in page.text
    for address, headers in (
        ("/nowhere", {}),
        ("/api/v1/nowhere", browsers),
        ("/api/v1/lots/L9", browsers),
        ("/" * 30_000, browsers),  # the way up from there would be in each link of the page
    ):
        problem = await client.get(HOST + address, headers=headers)
        assert problem.status_code == 404
        assert problem.headers["Content-Type"] == "application/problem+json", address[:40]


async def test_pages_have_the_names_of_plant_and_instrument_in_title_and_head(
    client: httpx.AsyncClient, control: FakeControl
) -> None:
    plain = await client.get(HOST)
    assert "<title>stonefall</title>" in plain.text and ">stonefall</a>" in plain.text
    control.plant = PlantSettings(plant="@up@")
    assert "<title>@up@ – stonefall</title>" in (await client.get(HOST)).text
    control.plant = PlantSettings(plant="Nord <1>", line="Linie 2", instrument_serial="SF-7")
    named = await client.get(HOST, headers={"If-None-Match": plain.headers["ETag"]})
    assert "<title>Nord &lt;1&gt;, Linie 2, SF-7 – stonefall</title>" in named.text
    assert ">Nord &lt;1&gt;, Linie 2, SF-7 – stonefall</a>" in named.text


async def test_every_state_has_an_icon(client: httpx.AsyncClient) -> None:
    shown = installed_screens()
    for name in ("stonefall", *Ne107):
        icon = await client.get(f"{HOST}{ROOT}/{shown.version}/icons/{name}.svg")
        assert icon.status_code == 200 and icon.headers["Content-Type"].startswith("image/svg+xml")


def test_a_script_that_sets_a_title_imports_what_does() -> None:
    for path, file in installed_screens().files.items():
        text = file.content.decode() if path.startswith("scripts/") else ""
        if re.search(r"^\s*titled\(", text, re.MULTILINE):
            assert re.search(r"^import \{[^}]*\btitled\b", text, re.MULTILINE), path
