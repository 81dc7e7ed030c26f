"""The pages that people look at, and their files: static, the same for everybody, no data in them and no key needed.

A page names its files under the hash of all of them. So browsers keep these for ever, and have the new ones with the
first page after an upgrade. All of it is held in memory: it is small, and no name leads out of it. All addresses in a
page are relative to it, so that a proxy can have the pages below any path.
"""

import gzip
import hashlib
import json
import posixpath
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from html import escape
from pathlib import Path

from fastapi import APIRouter, HTTPException, Request
from fastapi.responses import Response

from service import screens
from service.base.language import Language, figure_names
from service.base.messages import message_words
from service.base.templates import templates_in
from service.web.context import Context
from service.web.etags import unchanged
from service.web.gzipped import TakesGzip
from service.web.version import BASE

router = APIRouter(include_in_schema=False)


@dataclass(frozen=True, slots=True)
class Page:
    """A page: `name` is that of its file in `service/screens/pages`, of its script and of its words."""

    name: str
    style: str | None = None
    """Name of the style sheet that it has beside the one of all pages."""
    section: str | None = None
    """Address of its link in the header; another page's for one that is found by way of that page."""


PAGES = {
    "/": Page("operator", style="operator", section="/"),
    "/lots": Page("lots", style="lots", section="/lots"),
    "/laboratory": Page("laboratory", style="lots", section="/lots"),
    "/shift": Page("shift", style="shift", section="/"),
    "/gallery": Page("gallery", style="stones", section="/gallery"),
    "/compare": Page("compare", style="stones", section="/compare"),
    "/setup": Page("setup", style="setup", section="/setup"),
    "/stones/{particle_id}": Page("passport", style="stones", section="/gallery"),
    "/verify": Page("verify", section="/lots"),
    "/sign-in": Page("sign-in"),
}
"""All pages by address; the header links those that are a section, in this order."""
MISSING = Page("missing")
"""The page of an address that there is none at."""
MOST_FOLDERS = 8
"""Depth of an address that is told so by a page, which names the way up in each of its links."""
SITE, UP = "@site@", "@up@"
"""Stand in a page where the name of plant and instrument comes, and the way up to the first page."""
ROOT = "/screens"
PACKAGES = "packages.json"
"""File that lists what was fetched from npm, so that a page need not try."""
MEDIA_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:;"
    " connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""What a browser lets a page do: everything comes from this host."""
HEADERS = {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer", "Vary": "Accept-Encoding"}


@dataclass(frozen=True, slots=True)
class File:
    """A file as browsers get it."""

    content: bytes
    gzipped: bytes
    media_type: str

    @classmethod
    def of(cls, content: bytes, media_type: str) -> "File":
        """Return the file with this content, compressed once."""
        return cls(content, gzip.compress(content, mtime=0), media_type)


@dataclass(frozen=True, slots=True)
class Screens:
    """All pages by name, `SITE` and `UP` still in them, and their files by path."""

    version: str
    pages: Mapping[str, str]
    files: Mapping[str, File]


@cache
def installed_screens() -> Screens:
    """Return the pages and files of this installation, those of npm packages if they are there."""
    folder = Path(screens.__file__).parent
    contents = dict(_read(folder))
    packages = sorted({path.split("/")[1] for path in contents if path.startswith("packages/")})
    contents[PACKAGES] = json.dumps(packages).encode()
    for language in Language:
        words = json.loads(contents[path := f"words/{language}.json"])
        contents[path] = json.dumps(
            {**words, **figure_names(language), **message_words(language)}, ensure_ascii=False
        ).encode()
    digest = hashlib.sha256(repr(PAGES).encode())
    for path, content in contents.items():
        digest.update(f"{path}\0{len(content)}\0".encode() + content)
    version = digest.hexdigest()[:16]
    templates = templates_in(folder / "pages")

    def rendered(page: Page) -> str:
        return templates.get_template(f"{page.name}.html").render(
            page=page,
            pages=PAGES,
            root=UP,
            files=f"{UP}{ROOT[1:]}/{version}",
            scripts=_scripts(page, contents),
            site=SITE,
        )

    pages = {page.name: rendered(page) for page in (*PAGES.values(), MISSING)}
    files = {
        path: File.of(content, MEDIA_TYPES[Path(path).suffix])
        for path, content in contents.items()
        if not path.startswith("pages/")
    }
    return Screens(version, pages, files)


def _scripts(page: Page, contents: Mapping[str, bytes]) -> list[str]:
    """Return the script of a page and all that it imports, which a browser would else find one after another."""
    found = [f"scripts/{page.name}.js"]
    for path in found:  # to which it appends
        imported = re.findall(r'^import .*? from "(.+?)";$', contents[path].decode(), re.MULTILINE)
        named = (posixpath.normpath(f"{posixpath.dirname(path)}/{name}") for name in imported)
        found += [each for each in named if each not in found]
    return found


def _read(folder: Path) -> Iterator[tuple[str, bytes]]:
    for path in sorted(folder.rglob("*")):
        if path.suffix in MEDIA_TYPES:
            yield path.relative_to(folder).as_posix(), path.read_bytes()


@lru_cache(maxsize=64)
def _page_of(name: str, site: str, depth: int) -> File:
    html = installed_screens().pages[name].replace(UP, "../" * depth or "./")
    html = html.replace(SITE, escape(f"{site} – " if site else ""))
    return File.of(html.encode(), MEDIA_TYPES[".html"])


async def page(request: Request, context: Context, compressed: TakesGzip) -> Response:
    """Return the page of this address."""
    address = request.scope["route"].path
    found = _page_of(PAGES[address].name, context.site(), address.count("/") - 1)
    tag = f'"{hashlib.sha256(found.content).hexdigest()[:16]}"'
    headers = {"ETag": tag, "Cache-Control": "no-cache", "Content-Security-Policy": POLICY}
    return unchanged(request, tag) or _response(found, compressed, headers)


def missing_page(request: Request) -> Response | None:
    """Return the page of an address that there is none at; None for who wants no page, within REST, and deep down."""
    path = request.scope["path"]
    depth = path.count("/") - 1
    wants_page = "text/html" in request.headers.get("accept", "")
    if path.startswith(BASE) or depth > MOST_FOLDERS or not wants_page:
        return None
    found = _page_of(MISSING.name, request.app.state.context.site(), depth)
    headers = {"Cache-Control": "no-store", "Content-Security-Policy": POLICY, **HEADERS}
    return Response(found.content, 404, media_type=found.media_type, headers=headers)


for _address, _page in PAGES.items():
    router.add_api_route(_address, page, methods=["GET"], name=f"page_{_page.name}")


@router.get(f"{ROOT}/{{version}}/{{path:path}}")
async def screen_file(version: str, path: str, compressed: TakesGzip) -> Response:
    """Return a file of a page; one of another version is not there any more."""
    shown = installed_screens()
    found = shown.files.get(path) if version == shown.version else None
    if found is None:
        raise HTTPException(404, f"the pages have no file {path!r} of version {version!r}")
    return _response(found, compressed, {"Cache-Control": "public, max-age=31536000, immutable"})


def _response(found: File, compressed: bool, headers: Mapping[str, str]) -> Response:
    coding = {"Content-Encoding": "gzip"} if compressed else {}
    content = found.gzipped if compressed else found.content
    return Response(content, media_type=found.media_type, headers={**HEADERS, **headers, **coding})
