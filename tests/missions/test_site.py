"""The site: made in one command without a network; every link leads somewhere, and no page asks anything elsewhere."""

import contextlib
import importlib
import shutil
import subprocess
import sys
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from types import GenericAlias

import pytest
from browsing import needs_browser, visiting
from page_pictures import PICTURES, RUNS

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Make the site as `make site` does; a warning, such as a link or an anchor that leads nowhere, is an error."""
    folder = tmp_path_factory.mktemp("site")
    doctrees = tmp_path_factory.mktemp("doctrees")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-q",
        "-W",
        "--keep-going",
        "-d",
        str(doctrees),
        "-b",
        "html",
    ]
    done = subprocess.run(
        [*command, "docs", str(folder)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    yield folder
    shutil.rmtree(folder)


def test_makefile_makes_the_site_as_this_test_does():
    assert (
        "sphinx-build -W --keep-going -b html -d build/doctrees docs build/site"
        in (ROOT / "Makefile").read_text()
    )


def test_every_page_is_found_and_every_public_name_is_in_the_reference(site):
    for page in (ROOT / "docs").rglob("*.md"):
        assert (site / page.relative_to(ROOT / "docs").with_suffix(".html")).is_file(), page
    linked = (site / "index.html").read_text()
    for page in (ROOT / "docs").rglob("*.md"):
        address = page.relative_to(ROOT / "docs").with_suffix(".html").as_posix()
        assert address == "index.html" or f'href="{address}"' in linked, (
            f"{page} is in no list of README.md"
        )
    for package in ("kb", "rosa_bt", "rosa_pddl", "suave_env", "missions.testing"):
        shown = (site / "api" / f"{package}.html").read_text()
        module = importlib.import_module(package)
        named = [
            name for name in module.__all__ if not isinstance(getattr(module, name), GenericAlias)
        ]
        assert not [name for name in named if f'id="{package}.{name}"' not in shown]


def test_every_picture_of_the_docs_is_made_by_one_command():
    made = {f"{one.name}.png" for one in PICTURES} | {f"{mission}.png" for mission, *_ in RUNS}
    assert {path.name for path in (ROOT / "docs").rglob("*.png")} == made
    rules = (ROOT / "Makefile").read_text().partition("\npictures:\n")[2].partition("\n\n")[0]
    assert "page_pictures.py" in rules
    gallery = (ROOT / "docs" / "gallery.md").read_text()
    for mission, *options in RUNS:
        assert (
            " ".join(["rosa run", mission, "--no-progress", *options, "--plot", f"{mission}.png"])
            in gallery
        )


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_): ...

    def copyfile(self, source, outputfile):
        with contextlib.suppress(ConnectionError):  # the page has gone on
            super().copyfile(source, outputfile)


@pytest.fixture
def address(site):
    """Of any web server that shows the folder."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(site))) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


@needs_browser
def test_site_is_read_at_any_width_searched_offline_and_asks_nobody(address):
    with visiting(address) as visit:
        for page in ("index", "tutorial", "api/kb", "coming_from/rosa", "gallery"):
            visit.page.goto(f"{address}{page}.html")
            for width, scheme in ((375, "dark"), (1440, "light")):
                visit.page.emulate_media(color_scheme=scheme)
                visit.page.set_viewport_size({"width": width, "height": 900})
                assert visit.page.evaluate("document.documentElement.scrollWidth") <= width, page
        visit.page.goto(f"{address}search.html?q=recharge")
        visit.page.wait_for_selector("ul.search li a")
        assert visit.elsewhere(address) == []
