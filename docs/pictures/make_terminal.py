"""Program that takes the picture `terminal.png` of a run. Needs tmux, Chromium and playwright."""

import io
import re
import subprocess
import time
from pathlib import Path

from playwright.sync_api import sync_playwright
from rich.console import Console
from rich.terminal_theme import MONOKAI
from rich.text import Text

HERE = Path(__file__).parent
STYLE = """<style>pre { background: #0c0c0c; color: #d9d9d9; font: 16px/1.2 monospace;
    padding: 12px; display: inline-block; margin: 0 }</style>"""
TMUX = ["tmux", "-L", "smarttouch-picture"]


def main() -> None:
    live = "env COLORTERM=truecolor smarttouch live"
    subprocess.run([*TMUX, "new-session", "-d", "-x", "80", "-y", "24", live], check=True)
    try:
        shown = ""
        while not re.search(r"time.* [2-9]\.\d s", shown):
            time.sleep(0.2)
            capture = [*TMUX, "capture-pane", "-p", "-e"]
            shown = subprocess.run(capture, check=True, capture_output=True, text=True).stdout
    finally:
        subprocess.run([*TMUX, "kill-server"], check=True)
    console = Console(record=True, width=80, file=io.StringIO())
    console.print(Text.from_ansi(shown, no_wrap=True))
    body = console.export_html(theme=MONOKAI, inline_styles=True, code_format="<pre>{code}</pre>")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path="/usr/bin/chromium", args=["--no-sandbox", "--headless"]
        )
        page = browser.new_page(viewport={"width": 900, "height": 600})
        page.set_content(STYLE + body)
        page.locator("pre").screenshot(path=HERE / "terminal.png")
        browser.close()


if __name__ == "__main__":
    main()
