"""``socket:``: patterns from other programs of the same user, as JSON on a Unix socket."""

import asyncio
import errno
import json
import socket
import struct
import threading
from collections.abc import Awaitable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError

from smarttouch.base.errors import SmartTouchError, SourceError
from smarttouch.base.posix import user_number
from smarttouch.profile import Profile
from smarttouch.running.pattern_program import Pattern, Program, Shown
from smarttouch.sources.source_contract import Frame

LONGEST_S = 60.0  # longest duration of one show, because a client can hang
MOST_BYTES = 4_000_000  # longest request
_LOOK_S = 0.05
_Gray = Annotated[int, Field(ge=0, le=255)]


class _Request(BaseModel, extra="forbid", strict=True):
    request: Literal["show", "put", "level", "stop", "status"]
    pattern: list[float] | list[list[float]] | None = None
    image: list[list[_Gray]] | None = None
    seconds: Annotated[float, Field(gt=0, le=LONGEST_S)] = 0.5
    level: float | None = None


class SocketSource(Program):
    """Source of patterns from programs that connect to ``socket:PATH``.

    Each request and each answer is a JSON object on one line. Requests call the methods of a
    session, so ramp, force and limits apply. A pattern ends when a new pattern arrives or when its
    client disconnects.
    """

    fixed_mode = True
    ended = "a program stopped the run through the socket"

    def __init__(self, path: str, profile: Profile) -> None:
        super().__init__(profile, f"socket {path}")
        self._listener, self._path = _listen(path), Path(path)
        self._closing, self._closed = threading.Event(), False
        self._task: asyncio.Task[None] | None = None
        self._newest_client: asyncio.StreamWriter | None = None  # client of the newest pattern

    def close(self) -> None:
        """Close all connections and remove the socket."""
        if not self._closed:
            self._closed = True
            self._listener.close()
            self._path.unlink(missing_ok=True)

    def end(self) -> None:
        """End the run. This can be called from any thread."""
        self._closing.set()

    def program(self) -> None:
        """Serve clients until the run is over."""
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            try:
                if _is_ours(writer.get_extra_info("socket")):
                    await self._attend(reader, writer)
            except (OSError, SmartTouchError, asyncio.CancelledError):
                pass  # the client has left, or the run is over
            finally:
                writer.close()

        server = await asyncio.start_unix_server(connected, sock=self._listener, limit=MOST_BYTES)
        # Present an empty pattern, so that time advances for screens and recordings.
        self.put(self._nothing, 0)
        while not self._closing.is_set():
            self._require_loop()
            await asyncio.sleep(_LOOK_S)
        server.close()

    async def _attend(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client until it disconnects, then end its pulses."""
        try:
            while line := await reader.readline():
                await self._answer(line, writer)
                await writer.drain()
                await asyncio.sleep(0)  # let a pattern start before the next request can end it
        except ValueError:
            _reply(writer, error=f"a request has more than {MOST_BYTES} bytes: send less")
        finally:
            if self._newest_client is writer:
                await self._put_newest(self._nothing, 0)

    async def _put_newest(self, pattern: Pattern, stale_s: float = 0.5) -> None:
        """Replace the current pattern, and end the current show."""
        self._end_task()
        # If time is simulated, `put` blocks, so call it in a thread to keep the event loop running.
        await asyncio.to_thread(self.put, pattern, stale_s)

    async def _answer(self, line: bytes, writer: asyncio.StreamWriter) -> None:
        """Execute and answer a request. A show request is answered when the show ends."""
        answer: dict[str, Any] = {}
        try:
            asked = _parse(line)
            if asked.request == "show":
                pattern, level = self._pattern(asked), asked.level
                self._end_task()
                shown = self.show_async(pattern, asked.seconds, 1.0 if level is None else level)
                self._task = asyncio.create_task(_shown(shown, writer))
                self._newest_client = writer
                return
            if asked.request == "put":
                pattern, self._newest_client = self._pattern(asked), writer
                await self._put_newest(pattern)
            elif asked.request == "level":
                if asked.level is None:
                    raise SourceError("request 'level' needs the key 'level', from 0 to 1")
                self.controls.set_level(asked.level)
            elif asked.request == "stop":
                self.end()
            else:
                state = self.controls.state(0)
                answer = {
                    "electrodes": self._nothing.shape[1], "mode": self.mode, "level": state.level,
                    "most_level": self.controls.most, "paused": state.paused,
                    "gate": self.gate, "patterns": self.frames, "dropped": self.dropped_frames,
                }  # fmt: skip
            _reply(writer, request=asked.request, **answer)
        except SmartTouchError as error:
            _reply(writer, error=str(error))

    def _end_task(self) -> None:
        if self._task is not None:
            self._task.cancel()

    def _pattern(self, asked: _Request) -> NDArray[np.float32] | Frame:
        """Return the activation or image of a request. Rows of classes that the run does not
        stimulate must be zero."""
        if (asked.pattern is None) == (asked.image is None):
            raise SourceError("give either pattern or image")
        try:
            array = np.array(asked.pattern if asked.image is None else asked.image)
        except ValueError:
            raise SourceError("the rows differ in length: give equally long rows") from None
        if asked.image is not None:
            return self.checked(Frame(array.astype(np.uint8), 0))
        if array.shape == self._nothing.shape and np.delete(array, self.afferents, axis=0).any():
            driven = ", ".join(afferent.name for afferent in self.afferents)
            raise SourceError(f"this run stimulates only {driven}: set all other rows to zero")
        return self.checked(array)


async def _shown(show: Awaitable[Shown], writer: asyncio.StreamWriter) -> None:
    """Wait for the end of a show, then answer its request."""
    try:
        _reply(writer, request="show", **asdict(await show))
    except SmartTouchError as error:
        _reply(writer, request="show", error=str(error))
    except asyncio.CancelledError:
        _reply(writer, request="show", error="a newer pattern or the end of the run ended the show")


def _parse(line: bytes) -> _Request:
    try:
        return _Request.model_validate_json(line)
    except ValidationError as error:
        first = error.errors()[0]
        where = "".join(f"{field_name}: " for field_name in first["loc"][:1])
        raise SourceError(f"a request is not valid: {where}{first['msg']}") from None


def _reply(writer: asyncio.StreamWriter, **answer: Any) -> None:
    if not writer.is_closing():
        writer.write(json.dumps({"ok": "error" not in answer, **answer}).encode() + b"\n")


def _is_ours(line: socket.socket) -> bool:
    """Return whether a client runs as this user; True if the system cannot tell."""
    option = getattr(socket, "SO_PEERCRED", None)
    if option is None:
        return True
    pid_uid_gid = line.getsockopt(socket.SOL_SOCKET, option, struct.calcsize("3i"))
    return bool(struct.unpack("3i", pid_uid_gid)[1] == user_number())


def _listen(path: str) -> socket.socket:
    """Return a listening socket that no other user can connect to."""
    if not path or path.isdigit() or "?" in path:
        raise SourceError(f"{path!r} is not the path of a socket: give one, as in socket:./touch")
    if not hasattr(socket, "AF_UNIX"):
        raise SourceError("this system has no Unix sockets: use a session in Python")
    line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        if Path(path).is_socket() and line.connect_ex(path) == errno.ECONNREFUSED:
            Path(path).unlink()  # left by an earlier run
        line.bind(path)
        Path(path).chmod(0o600)
        line.listen()
    except OSError as error:
        line.close()
        raise SourceError(f"cannot listen at {path}: {error.strerror or error}") from None
    return line
