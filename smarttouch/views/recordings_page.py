"""Recordings in the window: a page with a time line, served, or saved as pictures."""

import asyncio
import json
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Sequence
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
_TYPES = {
    ".json": "application/json", ".png": "image/png", ".svg": "image/svg+xml", ".mp4": "video/mp4",
}  # fmt: skip


class RecordingsPage(Closing):
    """Serves a page that shows one recording, or two side by side, until it is closed."""

    def __init__(self, paths: Sequence[Path]) -> None:
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
            self._server = PageServer(0, self._routes(), "view.html")
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
            Route("/step/{tape:int}/{first:int}", _answer(self._step, ".json")),
            Route("/felt/{tape:int}/{first:int}", _answer(self._felt, ".json")),
            *(
                Route(f"/view/{{tape:int}}/{{first:int}}{kind}", _answer(self._view, kind))
                for kind in (".png", ".svg")
            ),
            Route("/film/{tape:int}/{first:int}-{last:int}.mp4", _answer(self._film, ".mp4")),
        ]

    async def _about(self, request: "Request") -> "Response":
        from starlette.responses import Response

        start = _number(request, "from") or 0
        messages = [each.message(start) for each in self.tapes]
        return Response(json.dumps(messages), media_type="application/json")

    def _step(self, request: "Request") -> bytes:
        return self._tape(request).picture(request.path_params["first"])

    def _felt(self, request: "Request") -> bytes:
        return self._tape(request).response(request.path_params["first"])

    def _view(self, request: "Request") -> bytes:
        kind, first = Path(request.url.path).suffix, request.path_params["first"]
        return export_view(self._tape(request), first, kind, _number(request, "slot"))

    def _film(self, request: "Request") -> bytes:
        with tempfile.TemporaryDirectory(prefix="smarttouch-") as folder:
            path, place = Path(folder) / "film.mp4", request.path_params
            export_film(self._tape(request), path, place["first"], place["last"])
            return path.read_bytes()

    def _tape(self, request: "Request") -> RecordingIndex:
        number: int = request.path_params["tape"]
        return self.tapes[number]


def _number(request: "Request", name: str) -> int | None:
    text = request.query_params.get(name, "")
    return int(text) if text.isascii() and text.isdecimal() else None


def _answer(
    make: Callable[["Request"], bytes], kind: str
) -> Callable[["Request"], Awaitable["Response"]]:
    """Return the answer to requests for a file, which a thread makes; what is not there is 404."""

    async def answer(request: "Request") -> "Response":
        from starlette.responses import Response

        try:
            data = await asyncio.to_thread(make, request)
        except IndexError:
            return Response(status_code=404)
        except RecordingError as error:
            return Response(str(error), status_code=409, media_type="text/plain")
        headers = {}
        if kind != ".json":
            numbers = "-".join(str(each) for each in request.path_params.values())
            headers["content-disposition"] = f'attachment; filename="recording-{numbers}{kind}"'
        return Response(data, media_type=_TYPES[kind], headers=headers)

    return answer


def show_recordings(paths: Sequence[Path]) -> None:
    """Serve the page of recordings until Ctrl-C."""
    with RecordingsPage(paths) as page:
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
