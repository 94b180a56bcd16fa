"""Recordings shown in the window, and saved views of them."""

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from smarttouch.errors import RecordingError
from smarttouch.files import require_folder, write_bytes
from smarttouch.monitor.progress import lines_progress
from smarttouch.window.export import KINDS, export_film, export_view
from smarttouch.window.server import open_browser
from smarttouch.window.tape import Tape
from smarttouch.window.view import RecordingsPage


def show_recordings(paths: Sequence[Path], port: int = 0) -> None:
    """Serve the page of recordings until Ctrl-C."""
    with RecordingsPage(paths, port) as page:
        try:
            print(f"window: {page.address} (Ctrl-C ends)", file=sys.stderr, flush=True)
            open_browser(page.address)
            # Short waits: a signal just before a wait does not end it.
            while True:
                time.sleep(0.2)
        except KeyboardInterrupt:
            return


def save_view(path: Path, output: Path, step: int = 0, slot: int | None = None) -> None:
    """Write a step of a recording as a picture, or all from it on as a film."""
    if output.suffix not in KINDS:
        raise RecordingError(
            f"cannot write {output}: give a name that ends in {', '.join(KINDS)}", about="save"
        )
    require_folder(output)
    with Tape(path) as tape:
        tape.wait()
        try:
            if output.suffix == ".mp4":
                with lines_progress(False, "Writing the film") as advance:
                    export_film(tape, output, step, advance=advance)
            else:
                write_bytes(output, export_view(tape, step, output.suffix, slot))
        except IndexError:
            raise RecordingError(
                f"{path} has {len(tape)} steps, and no step {step} with slot {slot or 0}"
                f"{tape.wrong and f' ({tape.wrong})'}: choose another",
                about="step",
            ) from None
