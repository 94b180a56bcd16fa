"""A mouse of this machine, through Linux's evdev: its counts, before any acceleration."""

import contextlib
import select
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smarttouch.base.errors import SourceError, SourceLostError, require_within
from smarttouch.base.lazy_names import import_extra
from smarttouch.instruments.hand_motion import HandMotion
from smarttouch.pages.page_image import INCH_MM

if TYPE_CHECKING:
    from evdev import InputDevice

USUAL_CPI = 800.0  # default counts per inch of most mice
_FOLDER = Path("/dev/input")
_WAIT_S = 0.1
_GROUP = "join the group input (sudo usermod -aG input $USER) and log in again"


def open_evdev(rest: str, *, cpi: float = USUAL_CPI) -> "EvdevMotion":
    """Open ``evdev:DEVICE``, or the first mouse found; options are those of `EvdevMotion`."""
    require_within(SourceError, "cpi", cpi, 10, 100_000, f"a mouse of {cpi:g} counts per inch")
    return EvdevMotion(_open(rest) if rest else _first_mouse(), cpi)


class EvdevMotion(HandMotion):
    """Sum of a mouse's counts, read on a thread."""

    def __init__(self, device: "InputDevice[str]", cpi: float) -> None:
        super().__init__(f"{device.name} at {cpi:g} counts per inch")
        self.resolution_mm: float = INCH_MM / cpi
        self._device, self._path = device, str(device.path)
        self._counts = [0, 0]
        self._first: tuple[int, int] | None = None
        self._gone = self._closed = False
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._listen, name="mouse", daemon=True)
        self._thread.start()

    def read(self, time_ns: int) -> tuple[float, float]:
        """Return the displacement of the mouse since the first read."""
        if self._gone:
            raise SourceLostError(f"{self._path} is gone: plug the mouse in again")
        with self._lock:
            across, down = self._counts
        if self._first is None:
            self._first = (across, down)
        return (
            (across - self._first[0]) * self.resolution_mm,
            (down - self._first[1]) * self.resolution_mm,
        )

    def close(self) -> None:
        """Close the mouse."""
        if self._closed:
            return
        self._closed = True
        self._thread.join()
        with contextlib.suppress(OSError):
            self._device.close()

    def _listen(self) -> None:
        from evdev import ecodes

        moves = {ecodes.REL_X: 0, ecodes.REL_Y: 1}
        while not self._closed:
            try:
                ready, _, _ = select.select([self._device.fd], [], [], _WAIT_S)
                events = list(self._device.read()) if ready else []
            except BlockingIOError:
                continue
            except (OSError, ValueError):
                self._gone = True
                return
            with self._lock:
                for event in events:
                    if event.type == ecodes.EV_REL and event.code in moves:
                        self._counts[moves[event.code]] += event.value
                    elif event.type == ecodes.EV_SYN and event.code == ecodes.SYN_DROPPED:
                        self._note_lost()

    def _note_lost(self) -> None:
        words = "some motion of the mouse was lost: the machine is too busy"
        if words not in self.notes:
            self.notes.append(words)


def _open(path: str) -> "InputDevice[str]":
    evdev = _evdev()
    if not Path(path).exists():
        raise SourceError(f"no device {path}: see {_FOLDER}/by-id for what there is")
    try:
        device: InputDevice[str] = evdev.InputDevice(path, readonly=True)
    except PermissionError:
        raise SourceError(f"{path} may not be read by you: {_GROUP}") from None
    except OSError as error:
        raise SourceError(f"{path} is no input device: {error.strerror or error}") from None
    if not _is_mouse(device):
        name = device.name
        device.close()
        raise SourceError(f"{path}, {name}, reports no motion along two axes: choose a mouse")
    return device


def _first_mouse() -> "InputDevice[str]":
    evdev = _evdev()
    for path in sorted(evdev.list_devices(), key=_natural):
        with contextlib.suppress(OSError):
            device: InputDevice[str] = evdev.InputDevice(path, readonly=True)
            if _is_mouse(device):
                return device
            device.close()
    raise SourceError(f"no mouse among what you may read in {_FOLDER}: plug one in, or {_GROUP}")


def _natural(path: str) -> tuple[int, str]:
    return len(path), path


def _is_mouse(device: "InputDevice[str]") -> bool:
    from evdev import ecodes

    moves = device.capabilities().get(ecodes.EV_REL, [])
    return ecodes.REL_X in moves and ecodes.REL_Y in moves


def _evdev() -> Any:
    return import_extra("evdev", "evdev:, on Linux alone,", "mouse", SourceError)
