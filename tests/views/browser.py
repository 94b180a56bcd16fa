"""A real browser, Debian's Chromium, where it is installed; and axe-core, where that is."""

import shutil
from contextlib import contextmanager
from pathlib import Path

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
ARGUMENTS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
AXE = Path(__file__).parents[2] / "build/axe/node_modules/axe-core/axe.min.js"
"""Script of axe-core: see `.ci/run`."""


@contextmanager
def chromium():
    """Yield a browser; skip where there is none."""
    playwright = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("there is no Chromium: apt install chromium")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def opened(browser, address, width=1440, height=900, **options):
    """Yield a page; fail if a script of it failed or something was not loaded."""
    wrong = []
    page = browser.new_page(viewport={"width": width, "height": height}, **options)
    page.on("pageerror", lambda error: wrong.append(str(error)))

    def failed(request):
        # A stop is said twice: once one is heard, nobody may be there for the other.
        if not request.url.endswith("/stop"):
            wrong.append(request.url)

    page.on("requestfailed", failed)
    try:
        page.goto(address)
        yield page
        assert wrong == []
    finally:
        page.close()
