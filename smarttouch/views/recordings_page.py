"""Recordings in the window: a page with a time line, served, or saved as pictures."""

import asyncio
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from smarttouch.base.errors import RecordingError
from smarttouch.base.files import require_folder, write_bytes
from smarttouch.base.stopping import Closing
from smarttouch.views.progress import lines_progress
from smarttouch.views.recorded_pictures import KINDS, RecordingIndex, export_film, export_view
from smarttouch.views.window_server import PageServer, import_server, open_browser

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.routing import BaseRoute

MOST_RECORDINGS = 2
_TYPES = {".png": "image/png", ".svg": "image/svg+xml", ".mp4": "video/mp4"}


class RecordingsPage(Closing):
    """Serves a page that shows one recording, or two side by side, until it is closed."""

    def __init__(self, paths: Sequence[Path], port: int = 0) -> None:
        if not 0 < len(paths) <= MOST_RECORDINGS:
            raise RecordingError(
                f"{len(paths)} recordings cannot be shown at once: give one or {MOST_RECORDINGS}",
                about="files",
            )
        import_server()
        self.tapes: list[RecordingIndex] = []
        try:
            for path in paths:
                self.tapes.append(RecordingIndex(path))
            self._server = PageServer(port, self._routes(), "view.html")
        except BaseException:
            self._close_tapes()
            raise
        self.address: str = self._server.address
        self._server.start()

    def close(self) -> None:
        self._server.close()
        self._close_tapes()

    def _close_tapes(self) -> None:
        for each in self.tapes:
            each.close()

    def _routes(self) -> "list[BaseRoute]":
        from starlette.routing import Route

        return [
            Route("/recordings", self._about),
            Route("/step/{tape:int}/{step:int}", self._step),
            Route("/felt/{tape:int}/{step:int}", self._felt),
            Route("/view/{tape:int}/{step:int}.{kind}", self._view),
            Route("/film/{tape:int}/{first:int}-{last:int}.mp4", self._film),
        ]

    async def _about(self, request: "Request") -> "Response":
        from starlette.responses import Response

        first = request.query_params.get("from", "0")
        start = int(first) if first.isascii() and first.isdecimal() else 0
        messages = [each.message(start) for each in self.tapes]
        return Response(json.dumps(messages), media_type="application/json")

    async def _step(self, request: "Request") -> "Response":
        from starlette.responses import Response

        try:
            data = self._tape(request).picture(request.path_params["step"])
        except IndexError:
            return Response(status_code=404)
        return Response(data, media_type="application/json")

    async def _felt(self, request: "Request") -> "Response":
        from starlette.responses import Response

        try:
            tape = self._tape(request)
            data = await asyncio.to_thread(tape.response, request.path_params["step"])
        except IndexError:
            return Response(status_code=404)
        return Response(data, media_type="application/json")

    async def _view(self, request: "Request") -> "Response":
        from starlette.responses import Response

        kind, step = f".{request.path_params['kind']}", request.path_params["step"]
        text = request.query_params.get("slot", "")
        slot = int(text) if text.isascii() and text.isdecimal() else None
        try:
            if kind not in (".png", ".svg"):
                raise IndexError(kind)
            tape = self._tape(request)
            data = await asyncio.to_thread(export_view, tape, step, kind, slot)
        except IndexError:
            return Response(status_code=404)
        return _file(data, kind, f"{tape.recording.path.stem}-{step}")

    async def _film(self, request: "Request") -> "Response":
        from starlette.responses import Response

        first, last = request.path_params["first"], request.path_params["last"]
        try:
            tape = self._tape(request)
            data = await asyncio.to_thread(_film_of, tape, first, last)
        except IndexError:
            return Response(status_code=404)
        except RecordingError as error:
            return Response(str(error), status_code=409, media_type="text/plain")
        return _file(data, ".mp4", f"{tape.recording.path.stem}-{first}-{last}")

    def _tape(self, request: "Request") -> RecordingIndex:
        number: int = request.path_params["tape"]
        return self.tapes[number]


def _film_of(tape: RecordingIndex, first: int, last: int) -> bytes:
    with tempfile.TemporaryDirectory(prefix="smarttouch-") as folder:
        path = Path(folder) / "film.mp4"
        export_film(tape, path, first, last)
        return path.read_bytes()


def _file(data: bytes, kind: str, stem: str) -> "Response":
    from starlette.responses import Response

    plain = "".join(each if each.isascii() and each.isalnum() else "-" for each in stem)
    headers = {"content-disposition": f'attachment; filename="{plain}{kind}"'}
    return Response(data, media_type=_TYPES[kind], headers=headers)


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
    with RecordingIndex(path) as tape:
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
