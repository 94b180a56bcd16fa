"""``socket:``: images or activations of another program of this user, over a local socket.

A program connects and sends one PGM image after another (http://netpbm.sourceforge.net/doc/pgm.html),
which is three lines of text and then bytes, row by row::

    P5
    WIDTH HEIGHT
    255
"""

import contextlib
import re
import select
import socket
import stat
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import SourceError
from smarttouch.instruments.pushed_stimuli import LOOK_S, TCP_TABLES, PushedStimuli, is_from_us
from smarttouch.profile import Profile
from smarttouch.sources.live_capture import ImageDevice, LiveSource, Shot
from smarttouch.sources.source_contract import DeviceWarnings, Source

MOST_PIXELS = 4_000_000
_HEAD = re.compile(rb"P5\s(?:#[^\n]*\n)*\s*(\d+)\s+(\d+)\s+(\d+)\s")
_LONGEST_HEAD = 1000
_PIECE = 1 << 16


def open_socket(
    rest: str, profile: Profile, *, activation: bool = False, follow: bool = False
) -> Source:
    """Open ``socket:PORT`` of 127.0.0.1, or ``socket:PATH`` of a Unix socket.

    With ``activation`` an image is the activation of the electrodes, of all classes (E x 1) or RA,
    SAI and PC (E x 3), 255 full. Otherwise images are gray levels of what a sensor sees, bright is
    white. With ``follow`` each is one pulse, see `PushedStimuli`.
    """
    device = SocketImages(rest, profile)
    if not activation:
        return LiveSource(device, profile, follow=follow)
    return SocketStimuli(device, profile, follow)


class SocketImages(ImageDevice):
    """Images of the program that is connected, one program at a time; white paper before the
    first."""

    def __init__(self, place: str, profile: Profile) -> None:
        self.title: str = f"socket {place}"
        self.refused: int = 0
        self.wrong: int = 0
        self._place, self._optics = place, profile.optics
        self._listener: socket.socket | None = None
        self._line: socket.socket | None = None
        self._data = bytearray()
        self._began = False
        self._warnings = DeviceWarnings(self.notes)

    def open(self) -> None:
        self._listener = _listening(self._place)

    @property
    def address(self) -> tuple[str, int] | str:
        """Where it listens."""
        assert self._listener is not None
        found: tuple[str, int] | str = self._listener.getsockname()
        return found

    def grab(self, timeout_s: float) -> Shot | None:
        if not self._began:
            self._began = True
            blank = np.full((self._optics.sensor_rows, self._optics.sensor_columns), 255, np.uint8)
            # Too old to make current.
            return Shot(blank, time.perf_counter_ns() - 3600 * 10**9)
        return self.newest(timeout_s)

    def newest(self, timeout_s: float) -> Shot | None:
        """Return the newest image that is complete; None at the time limit."""
        assert self._listener is not None
        deadline_s = time.monotonic() + timeout_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            waits_for = self._listener if self._line is None else self._line
            if not select.select([waits_for], [], [], left_s)[0]:
                break
            if self._line is None:
                self._accept(self._listener)
            elif (shot := self._receive(self._line)) is not None:
                return shot
        return None

    def _accept(self, listener: socket.socket) -> None:
        line = listener.accept()[0]
        with contextlib.suppress(OSError):
            if is_from_us(line):
                line.setblocking(False)
                self._line = line
                self._data.clear()
                return
        line.close()
        self.refused += 1
        self._warnings.put(
            "refused",
            f"{self.refused} connections were refused: they were of other users, or of programs "
            "that had closed them",
        )

    def _receive(self, line: socket.socket) -> Shot | None:
        images: list[NDArray[np.uint8]] = []
        over = False
        with contextlib.suppress(BlockingIOError):
            while True:
                try:
                    piece = line.recv(_PIECE)
                except BlockingIOError:
                    raise
                except OSError:
                    piece = b""
                over = not piece
                if over:
                    break
                self._data += piece
                try:
                    images += _complete(self._data)
                except ValueError as wrong:
                    self.wrong += 1
                    self._warnings.put(
                        "wrong", f"{self.wrong} connections were closed, as they sent {wrong}"
                    )
                    over = True
                    break
                if images:
                    break
        if over:
            line.close()
            self._line = None
        if not images:
            return None
        return Shot(images[-1], time.perf_counter_ns(), len(images) - 1)

    def close(self) -> None:
        place = Path(self._place)
        for each in (self._line, self._listener):
            if each is not None:
                each.close()
        if self._listener is not None and "/" in self._place:
            with contextlib.suppress(OSError):
                place.unlink()
        self._line = self._listener = None


def _complete(data: bytearray) -> list[NDArray[np.uint8]]:
    """Return the images that are complete, and remove them; ValueError, in words, for others."""
    images: list[NDArray[np.uint8]] = []
    while True:
        head = _HEAD.match(data[:_LONGEST_HEAD])
        if head is None:
            if len(data) >= _LONGEST_HEAD or not b"P5".startswith(bytes(data[:2])):
                raise ValueError("no PGM image (P5)")
            return images
        width, height, most = map(int, head.groups())
        if not (width > 0 and height > 0 and width * height <= MOST_PIXELS and 0 < most < 256):
            raise ValueError(
                f"an image of {width} x {height} with levels up to {most}: at most "
                f"{MOST_PIXELS / 1e6:g} megapixels and 255 are read"
            )
        end = head.end() + width * height
        if len(data) < end:
            return images
        image = np.frombuffer(bytes(data[head.end() : end]), np.uint8).reshape(height, width)
        if most < 255:
            scaled = np.rint(np.minimum(image, most) * (255 / most))
            image = scaled.astype(np.uint8)
        images.append(image)
        del data[:end]


class SocketStimuli(PushedStimuli):
    """Activations of the program that is connected."""

    def __init__(self, device: SocketImages, profile: Profile, follow: bool) -> None:
        super().__init__(device.title, profile, follow)
        self.notes: list[str] = device.notes
        self.device = device
        self._shapes = [(rows, len(profile.electrodes)) for rows in (1, len(Afferent))]
        device.open()
        self._thread.start()

    def receive(self) -> None:
        shot = self.device.newest(LOOK_S)
        if shot is None:
            return
        self.dropped_frames += shot.missed
        self.frames += shot.missed
        if shot.image.shape in self._shapes:
            level = np.asarray(shot.image / np.float32(255), np.float32)
            self.push(np.ascontiguousarray(np.broadcast_to(level, self._shapes[1])))
        else:
            self.wrong += 1

    def close(self) -> None:
        super().close()
        self.device.close()
        wide = self._shapes[0][1]
        self._note_wrong(
            f"activations were not {wide} wide and 1 or 3 high, as this array needs them"
        )


def _listening(place: str) -> socket.socket:
    """Return a socket that programs of this machine can connect to."""
    if "/" in place:
        return _listening_at(Path(place))
    if not re.fullmatch(r"\d{1,5}", place, re.ASCII) or not int(place) < 65536:
        raise SourceError(
            f"{place!r} is no place to listen at: give a port, as in socket:9000, or the path of a "
            "socket, as in socket:/tmp/touch",
            about="address",
        )
    if not TCP_TABLES[0].exists():
        raise SourceError(
            f"this system has no {TCP_TABLES[0]}, which says whose program connects: give the path "
            "of a socket, as in socket:/tmp/touch",
            about="address",
        )
    try:
        return socket.create_server(("127.0.0.1", int(place)), backlog=1)
    except OSError as error:
        raise SourceError(
            f"cannot listen at port {place}: {error.strerror or error}; give another, as in "
            "socket:9001",
            about="address",
        ) from None


def _listening_at(path: Path) -> socket.socket:
    if not hasattr(socket, "AF_UNIX") or not hasattr(socket, "SO_PEERCRED"):
        raise SourceError(
            "this system has no sockets that say whose program connects", about="address"
        )
    line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        # Left by an earlier run: no program listens there.
        if path.exists() and stat.S_ISSOCK(path.stat().st_mode) and line.connect_ex(str(path)):
            path.unlink()
        line.close()
        line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        line.bind(str(path))
        path.chmod(0o600)
        line.listen(1)
    except OSError as error:
        line.close()
        raise SourceError(
            f"cannot listen at {path}: {error.strerror or error}; give another path",
            about="address",
        ) from None
    return line
