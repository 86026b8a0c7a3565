"""A real browser for tests of the page: headless Chromium, with its requests and console."""

import shutil
from contextlib import contextmanager

import pytest

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
QUIET = (
    *(
        "--no-sandbox",
        "--disable-gpu",
        "--disable-quic",
        "--no-first-run",
        "--disable-background-networking",
    ),
    *("--disable-component-update", "--disable-sync"),
)
WAIT_MS = 120_000
"""How long a page may take for what it is to show; a busy machine is no failure."""

needs_browser = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium is installed here: apt-get install chromium"
)


class Visit:
    """A page that is open, with what it asked of the network and said on the console."""

    def __init__(self, page):
        self.page = page
        self.requests = []
        self.said = []
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("websocket", lambda socket: self.requests.append(socket.url))
        page.on("console", lambda message: self.said.append(message.text))
        page.on("pageerror", lambda error: self.said.append(str(error)))

    def elsewhere(self, *own):
        """Return the requests that went anywhere but to where these begin."""
        return [
            request for request in self.requests if not request.startswith(("data:", "blob:", *own))
        ]


@contextmanager
def visiting(url, *, width=1440, height=900, **options):
    """Open a page in a browser of its own."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as player:
        browser = player.chromium.launch(executable_path=CHROMIUM, args=list(QUIET))
        page = browser.new_page(viewport={"width": width, "height": height}, **options)
        page.set_default_timeout(WAIT_MS)
        visit = Visit(page)
        page.goto(str(url))
        try:
            yield visit
        finally:
            browser.close()
