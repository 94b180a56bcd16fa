"""Program that takes the pictures `window*.png` of a run. Needs Chromium and playwright."""

import threading
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

import smarttouch as st
from smarttouch.base.stopping import StopRequest
from smarttouch.running.runner import Runner
from smarttouch.views.window import Window

HERE = Path(__file__).parent
ARGUMENTS = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-sync")


@contextmanager
def running(url):
    """Start a run with a window on a simulated board, and yield the address of the window."""
    profile, stop = st.load_profile("electric-mouse"), StopRequest()
    window = Window(stop, show=lambda _: None, waits_s=600)
    display = st.open_display("simulated:", profile)
    runner = Runner(
        st.open_source(url, profile), display, st.RunConfig(intensity=0.8, paced=True), stop=stop,
        listeners=[window],
    )  # fmt: skip
    thread = threading.Thread(target=runner.run)
    thread.start()
    try:
        yield window.address
    finally:
        stop.ask("the pictures are taken")
        thread.join()


def take(page, name, full_page=False):
    """Save a screenshot of a page, with few colors for a small file."""
    image = Image.open(BytesIO(page.screenshot(full_page=full_page))).convert("RGB")
    palette = image.quantize(method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    palette.save(HERE / name, optimize=True)


def main():
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path="/usr/bin/chromium", args=[*ARGUMENTS])

        def opened(address, width, height=900):
            page = browser.new_page(viewport={"width": width, "height": height})
            page.set_default_timeout(300_000)
            page.goto(address)
            return page

        with running("text:touch what it sees?speed_mm_s=1") as address:
            for width, name in ((1440, "window.png"), (360, "window-phone.png")):
                page = opened(address, width)
                page.wait_for_selector("#electrodes[data-number]")
                page.wait_for_timeout(3000)
                take(page, name, full_page=width < 1000)
                page.close()
        browser.close()


if __name__ == "__main__":
    main()
