"""Web server of the window, in a thread, only for this machine. Its address contains a secret."""

import atexit
import contextlib
import html
import os
import secrets
import shutil
import socket
import sys
import tempfile
import threading
import time
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smarttouch.base.errors import SmartTouchError, import_extra
from smarttouch.base.files import write_bytes
from smarttouch.base.posix import prioritized

if TYPE_CHECKING:
    import uvicorn
    from starlette.routing import BaseRoute

HOST = "127.0.0.1"
MOST_MESSAGE_BYTES = 65_536  # longest message from a page; a longer message ends the connection
PAGE_FOLDER = Path(__file__).parent / "page"
_JOIN_S = 1.0
_FILE_KEPT_S = 60.0  # time for a browser to start and read the file of `open_browser`
_LEADS_TO = (
    '<!doctype html><meta charset="utf-8"><meta name="referrer" content="no-referrer">'
    '<meta http-equiv="refresh" content="0;url={0}"><title>SmartTouch</title>'
    '<a href="{0}">SmartTouch</a>\n'
)
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "cache-control": "no-store",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
}


class PageServer:
    """Web server for the page's files and for ``routes``. All paths begin with a secret. The server
    refuses requests for another host, from another origin or without the secret."""

    def __init__(self, routes: "Sequence[BaseRoute]") -> None:
        server = import_server()
        from starlette.applications import Starlette
        from starlette.routing import Mount
        from starlette.staticfiles import StaticFiles

        # From here on, the system queues connections instead of refusing them.
        self._socket = socket.create_server((HOST, 0), backlog=128)
        self.port: int = int(self._socket.getsockname()[1])
        self._prefix = f"/{secrets.token_urlsafe(24)}/"
        self.address: str = f"http://{HOST}:{self.port}{self._prefix}live.html"
        self._hosts = {f"{host}:{self.port}" for host in (HOST, "localhost")}
        # Some browsers do not count a web socket of the same host as 'self'.
        sockets = " ".join(f"ws://{host}" for host in sorted(self._hosts))
        policy = f"{_POLICY}; connect-src 'self' {sockets}"
        self._headers = {"content-security-policy": policy, **_HEADERS}
        self._inner = Starlette(routes=[*routes, Mount("/", StaticFiles(directory=PAGE_FOLDER))])
        config = server.Config(
            self._guarded, interface="asgi3", http="h11", ws="websockets-sansio",
            ws_max_size=MOST_MESSAGE_BYTES, ws_per_message_deflate=False, loop="asyncio",
            lifespan="off", log_config=None, log_level="critical", access_log=False,
            server_header=False, timeout_graceful_shutdown=1,
        )  # fmt: skip
        self._server: uvicorn.Server = server.Server(config)
        self._thread = threading.Thread(target=self._serve, name="window", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        """End all connections."""
        self._server.should_exit = self._server.force_exit = True
        if self._thread.is_alive():
            self._thread.join(_JOIN_S)
        self._socket.close()

    # Without priority, this thread could be paused while it holds the global interpreter lock.
    @prioritized()
    def _serve(self) -> None:
        self._server.run([self._socket])

    async def _guarded(self, scope: Any, receive: Any, send: Any) -> None:
        """Serve allowed requests, with headers that restrict the page."""
        headers = {name.decode("latin-1"): value for name, value in scope["headers"]}
        if not self._allows(scope, headers):
            await _refuse(scope, send)
            return

        async def send_with_headers(message: Any) -> None:
            if message["type"] == "http.response.start":
                added = [(name.encode(), value.encode()) for name, value in self._headers.items()]
                message["headers"] = [*message["headers"], *added]
            await send(message)

        path = scope["path"][len(self._prefix) - 1 :]
        await self._inner({**scope, "path": path, "root_path": ""}, receive, send_with_headers)

    def _allows(self, scope: Any, headers: dict[str, bytes]) -> bool:
        origin = headers.get("origin", b"").decode("latin-1")
        # A link may open the page. Requests that change the run must come from the page itself.
        acts = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        ours = origin in {f"http://{host}" for host in self._hosts} or not (origin or acts)
        path = scope["path"][: len(self._prefix)].encode()
        return (
            headers.get("host", b"").decode("latin-1") in self._hosts
            and ours
            and secrets.compare_digest(path, self._prefix.encode())
        )


async def _refuse(scope: Any, send: Any) -> None:
    if scope["type"] == "websocket":
        # Closing before accepting makes the server answer 403.
        await send({"type": "websocket.close", "code": 1008})
        return
    await send({"type": "http.response.start", "status": 403, "headers": []})
    await send({"type": "http.response.body", "body": b"forbidden"})


def import_server() -> Any:
    """Import and return uvicorn. Raises SmartTouchError if the extra ``window`` is missing."""
    modules = ("starlette", "websockets", "uvicorn")
    return [import_extra(module, "a window", "window") for module in modules][-1]


def has_browser() -> bool:
    """Return whether there is a desktop with a browser."""
    return sys.platform in ("win32", "darwin") or any(
        os.environ.get(variable) for variable in ("DISPLAY", "WAYLAND_DISPLAY")
    )


def open_browser(address: str) -> None:
    """Open an address in the desktop's browser, if there is one, without waiting. The browser gets
    a private file that redirects to the address. The address itself must not be an argument of a
    program: all users of the machine can read arguments, and the address has a secret."""
    if not has_browser():
        return

    def show() -> None:
        with contextlib.suppress(webbrowser.Error, OSError, SmartTouchError):
            folder = Path(tempfile.mkdtemp(prefix="smarttouch-"))
            # Delete the file even if the program ends before this thread.
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
            page = folder / "window.html"
            write_bytes(page, _LEADS_TO.format(html.escape(address)).encode())
            webbrowser.open(page.as_uri())
            time.sleep(_FILE_KEPT_S)
            shutil.rmtree(folder, ignore_errors=True)

    threading.Thread(target=show, name="browser", daemon=True).start()
