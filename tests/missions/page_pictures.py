"""Draws the pictures of the docs: `make pictures`, with a Chromium on this machine.

Same sources, same bytes.
"""

import sys
from pathlib import Path
from typing import NamedTuple

from browsing import CHROMIUM, QUIET
from playwright.sync_api import sync_playwright
from test_page_in_browser import recorded

from missions import cli
from missions.views.report import write_report

DOCS = Path(__file__).parents[2] / "docs"
MOST = 250_000  # bytes of a page
RUNS = (("suave_extended",), ("agv",), ("uav", "--task", "pddl", "--seed", "4"))
"""The runs that docs/gallery.md shows, as it says how they are made."""


class Picture(NamedTuple):
    """What of which run, how wide and high [px], and in which scheme."""

    name: str
    mission: str
    task: str
    link: str
    size: tuple[int, int]
    scheme: str


PICTURES = (
    Picture(
        "page_desk",
        "suave_extended",
        "bt",
        "#t=151&a=7&e=attribute+water_visibility",
        (1440, 900),
        "light",
    ),
    Picture("page_dark", "agv", "pddl", "#t=12&a=1", (1440, 900), "dark"),
    Picture("page_telephone", "uav", "bt", "#t=122.7&a=2", (375, 780), "light"),
)


def main() -> None:
    """Draw the runs of the gallery; then run a mission for each page, and photograph its report."""
    for mission, *options in RUNS:
        plot = str(DOCS / f"{mission}.png")
        cli.app(["run", mission, *options, "--no-progress", "--plot", plot], standalone_mode=False)
    if CHROMIUM is None:
        sys.exit("no chromium on this machine: apt-get install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(QUIET))
        for picture in PICTURES:
            report = DOCS / f"{picture.name}.html"
            target = DOCS / f"{picture.name}.png"
            write_report(report, recorded(picture.mission, picture.task))
            width, height = picture.size
            page = browser.new_page(
                viewport={"width": width, "height": height}, color_scheme=picture.scheme
            )
            page.goto(report.as_uri() + picture.link)
            page.wait_for_selector(".chain")
            page.wait_for_timeout(500)  # canvases are drawn after the first paint
            page.screenshot(path=target)
            report.unlink()
            if target.stat().st_size > MOST:
                sys.exit(f"{target} is {target.stat().st_size} bytes; {MOST} are allowed")
        browser.close()


if __name__ == "__main__":
    main()
