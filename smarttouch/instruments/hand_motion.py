"""Motion of a hand, opened by URL: a recorded path, the pose of a source, a virtual hand, or a
mouse.

A mouse is read through Linux's evdev: raw counts without acceleration.
"""

import contextlib
import math
import select
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import SourceError, SourceLostError, import_extra, require_within
from smarttouch.base.files import read_csv
from smarttouch.base.urls import all_options, unknown
from smarttouch.pages.page_and_lines import INCH_MM
from smarttouch.profile import DEFAULT_PROFILE, Profile, load_profile
from smarttouch.sources import SOURCES, open_source
from smarttouch.sources.source_contract import Device, Pose, Source

if TYPE_CHECKING:
    from evdev import InputDevice

_NOT_IN_URLS = ("span_mm", "lane_mm", "origin_mm")
"""Options of a sweep that are derived from the texture."""


class HandMotion(Device, ABC):
    """Base class of sources of a hand's displacement.

    After the first read, `origin_mm` is the distance of the starting place from the texture's top
    left corner, or None for the middle. If `knows_force` is set, `force_n` is the latest force.
    """

    duration_s: float | None = None  # duration of the motion; None if endless
    resolution_mm: float = 0.0
    """Resolution of the motion; at rest, the motion jitters by this amount."""

    def __init__(self, title: str) -> None:
        super().__init__(title)
        self.knows_force = self.measures_force = False
        self.force_n: float = math.nan
        self.origin_mm: tuple[float, float] | None = None

    @abstractmethod
    def read(self, time_ns: int) -> tuple[float, float] | None:
        """Return the displacement since the start, mm right and down; None after the end."""


def open_motion(url: str, **options: Any) -> HandMotion:
    """Open a motion: ``sweep:``, ``evdev:DEVICE``, ``path:CSV``, or any source with a pose. Options
    can be in the URL, as in ``sweep:?speed_mm_s=20``. If an option is None, its default applies."""
    kind, colon, rest = url.partition(":")
    openers: dict[str, Callable[..., HandMotion]] = {
        "evdev": open_evdev, "path": open_path, "sweep": open_sweep,
    }  # fmt: skip
    known = [*openers, *SOURCES.names]
    if not colon or kind not in known:
        raise unknown("motion", url, known, SourceError)
    opener, rest = (openers[kind], rest) if kind in openers else (open_posed_source, url)
    rest, accepted = all_options(opener, url, rest, options, SourceError, _NOT_IN_URLS)
    return opener(rest, **accepted)


_PATH_RESOLUTION_MM = 0.01  # resolution of recorded paths (our estimate)


def open_path(rest: str) -> "PathMotion":
    """Open ``path:CSV``."""
    if not rest:
        raise SourceError("path: needs a file name, as in path:way.csv")
    return PathMotion(Path(rest))


class PathMotion(HandMotion):
    """Motion in straight lines between the points of a CSV file. The file has columns ``time_s``,
    ``x_mm``, ``y_mm`` (from the texture's top left corner) and optionally ``force_n``; other
    columns are ignored."""

    resolution_mm = _PATH_RESOLUTION_MM

    def __init__(self, path: Path) -> None:
        super().__init__(f"the path of {path.name}")
        columns = read_csv(path, SourceError, ("time_s", "x_mm", "y_mm"), ("force_n",))
        self.knows_force: bool = "force_n" in columns
        table = np.column_stack([*columns.values()])
        table[:, 0] -= table[0, 0]
        self._table = table
        self.duration_s: float = float(table[-1, 0])
        self.origin_mm: tuple[float, float] = (float(table[0, 1]), float(table[0, 2]))

    def read(self, time_ns: int) -> tuple[float, float] | None:
        """Return the displacement from the first point; None after the last point."""
        time_s, times = time_ns / 1e9, self._table[:, 0]
        if time_s > times[-1]:
            return None
        x, y, *force = (float(np.interp(time_s, times, column)) for column in self._table.T[1:])
        if force:
            self.force_n: float = max(0.0, force[0])
        assert self.origin_mm is not None
        return x - self.origin_mm[0], y - self.origin_mm[1]


_IMAGE_RESOLUTION_MM = 0.02  # jitter of image-based motion at rest (our estimate)


def open_posed_source(url: str, *, profile: Profile | None = None) -> "SourceMotion":
    """Open any source whose frames have poses. The default profile is electric-mouse."""
    return SourceMotion(open_source(url, profile or load_profile(DEFAULT_PROFILE)))


class SourceMotion(HandMotion):
    """Motion that follows the pose of a source; `close` closes the source."""

    resolution_mm = _IMAGE_RESOLUTION_MM

    def __init__(self, source: Source) -> None:
        super().__init__(f"the motion of {source.title}")
        self._source = source
        self.notes: list[str] = source.notes
        self.knows_force: bool = source.knows_force
        self.measures_force: bool = source.measures_force
        self.duration_s: float | None = source.duration_s
        self._first: Pose | None = None

    def read(self, time_ns: int) -> tuple[float, float] | None:
        """Return the displacement since the first frame of the source; None after the last."""
        frame = self._source.read(time_ns)
        if frame is None:
            return None
        if self._first is None:
            self._first = frame.pose
        # A stale frame does not show whether the finger still presses, so force is unknown.
        self.force_n: float = math.nan if frame.stale else frame.force_n
        return frame.pose.x_mm - self._first.x_mm, frame.pose.y_mm - self._first.y_mm

    def close(self) -> None:
        """Close the source."""
        self._source.close()


USUAL_MM_S = 40.0
SLOWEST_MM_S, FASTEST_MM_S = 0.1, 1000.0
START_S = 0.75  # rest before the first stroke
REST_S = 0.3  # rest between two strokes
USUAL_ROUNDS = 1
_MOST_ROUNDS = 10_000
_MOST_STROKES = 100_000


def open_sweep(
    rest: str,
    *,
    speed_mm_s: float = USUAL_MM_S,
    span_mm: tuple[float, float] = (60.0, 0.0),
    lane_mm: float = 16.0,
    origin_mm: tuple[float, float] | None = None,
) -> "SweepMotion":
    """Open ``sweep:`` or ``sweep:ROUNDS``; for the options see `SweepMotion` and `HandMotion`."""
    if rest and not (rest.isdecimal() and 0 < int(rest) <= _MOST_ROUNDS):
        raise SourceError(
            f"sweep:{rest} is not a number of rounds: give 1 to {_MOST_ROUNDS}, as in sweep:3"
        )
    motion = SweepMotion(speed_mm_s, span_mm, lane_mm, int(rest or USUAL_ROUNDS))
    motion.origin_mm = origin_mm
    return motion


def strokes_over(size_mm: tuple[float, float], array_mm: tuple[float, float]) -> dict[str, Any]:
    """Return the options of `open_sweep` for strokes that move all electrodes over a texture."""
    (width, height), (across, down) = size_mm, array_mm
    return {
        "span_mm": (width + across, height),
        "lane_mm": down,
        "origin_mm": (-across / 2, min(down, height) / 2),
    }


class SweepMotion(HandMotion):
    """Virtual hand that moves over an area along parallel lanes, then back on the same path. It
    rests after each stroke."""

    def __init__(
        self,
        speed_mm_s: float = USUAL_MM_S,  # speed of strokes
        span_mm: tuple[float, float] = (60.0, 0.0),  # width and height of the area
        lane_mm: float = 16.0,  # largest distance between lanes
        rounds: int = USUAL_ROUNDS,  # number of rounds, each along all lanes and back
    ) -> None:
        require_within(SourceError, "speed_mm_s", speed_mm_s, SLOWEST_MM_S, FASTEST_MM_S)
        super().__init__(f"a virtual hand at {speed_mm_s:g} mm/s")
        points = _round_trip(span_mm, lane_mm)
        if rounds * len(points) > _MOST_STROKES:
            raise SourceError(
                f"{rounds} rounds of {len(points) // 2} lanes are more than "
                f"{_MOST_STROKES} strokes: give fewer rounds or a smaller texture"
            )
        self._table = _timed(np.vstack([points[:1], *[points[1:]] * rounds]), speed_mm_s)
        self.duration_s: float = float(self._table[-1, 0])

    def read(self, time_ns: int) -> tuple[float, float] | None:
        """Return the displacement of the hand at a time; None after the end of the motion."""
        time_s = time_ns / 1e9
        if time_s > self._table[-1, 0]:
            return None
        x, y = (float(np.interp(time_s, self._table[:, 0], column)) for column in self._table.T[1:])
        return x, y


def _round_trip(span_mm: tuple[float, float], lane_mm: float) -> NDArray[np.float64]:
    """Return the corners of the path along all lanes and back, (N, 2) mm."""
    width_mm, height_mm = span_mm
    lanes = max(1, math.ceil(height_mm / lane_mm - 0.15)) if height_mm > lane_mm else 1
    forth = [
        (x, y)
        for lane, y in enumerate(np.linspace(0, max(0.0, height_mm - lane_mm), lanes))
        for x in ((0.0, width_mm) if lane % 2 == 0 else (width_mm, 0.0))
    ]
    return np.array(forth + forth[-2::-1])


def _timed(points: NDArray[np.float64], speed_mm_s: float) -> NDArray[np.float64]:
    """Return two rows for each point, arrival and departure, (2 N, 3): time (s), x and y (mm)."""
    strokes_s = np.hypot(*np.diff(points, axis=0).T) / speed_mm_s
    comes = np.concatenate([[0.0], START_S + np.cumsum(strokes_s + REST_S) - REST_S])
    leaves = comes + REST_S
    leaves[0] = START_S
    times = np.column_stack([comes, leaves]).ravel()
    return np.column_stack([times, np.repeat(points, 2, axis=0)])


USUAL_CPI = 800.0  # counts per inch of most mice
_FOLDER = Path("/dev/input")
_WAIT_S = 0.1
_LOST = "some motion of the mouse was lost, as the computer is too busy: close other programs"
_GROUP = "join the group input (sudo usermod -aG input $USER) and log in again"


def open_evdev(rest: str, *, cpi: float = USUAL_CPI) -> "EvdevMotion":
    """Open ``evdev:DEVICE``, or the first mouse if no device is given. ``cpi`` is the mouse's
    resolution in counts per inch."""
    require_within(SourceError, "cpi", cpi, 10, 100_000, f"a mouse of {cpi:g} counts per inch")
    return EvdevMotion(_open(rest) if rest else _first_mouse(), cpi)


class EvdevMotion(HandMotion):
    """Motion of a mouse, whose counts are added up by a thread."""

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
            raise SourceLostError(f"{self._path} is gone: connect the mouse again")
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
                        self.notes[:] = dict.fromkeys([*self.notes, _LOST])


def _open(path: str) -> "InputDevice[str]":
    evdev = _evdev()
    if not Path(path).exists():
        raise SourceError(f"there is no device {path}: see {_FOLDER}/by-id for a list")
    try:
        device: InputDevice[str] = evdev.InputDevice(path, readonly=True)
    except PermissionError:
        raise SourceError(f"you have no permission to read {path}: {_GROUP}") from None
    except OSError as error:
        raise SourceError(f"{path} is not an input device: {error.strerror or error}") from None
    if not _is_mouse(device):
        name = device.name
        device.close()
        raise SourceError(f"{path} ({name}) does not report motion along two axes: choose a mouse")
    return device


def _first_mouse() -> "InputDevice[str]":
    evdev = _evdev()
    for path in sorted(evdev.list_devices(), key=lambda name: (len(name), name)):
        with contextlib.suppress(OSError):
            device: InputDevice[str] = evdev.InputDevice(path, readonly=True)
            if _is_mouse(device):
                return device
            device.close()
    raise SourceError(f"no mouse in {_FOLDER} can be read: connect a mouse, or {_GROUP}")


def _is_mouse(device: "InputDevice[str]") -> bool:
    from evdev import ecodes

    moves = device.capabilities().get(ecodes.EV_REL, [])
    return ecodes.REL_X in moves and ecodes.REL_Y in moves


def _evdev() -> Any:
    return import_extra("evdev", "evdev: (only on Linux)", "mouse", SourceError)
