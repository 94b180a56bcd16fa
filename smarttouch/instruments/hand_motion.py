"""Motion of a hand, opened by URL: a recorded path, a source's pose, a virtual hand, or a mouse.

A mouse of this machine is read through Linux's evdev: its counts, before any acceleration.
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
from smarttouch.pages.page_image import INCH_MM
from smarttouch.profile import DEFAULT_PROFILE, Profile, load_profile
from smarttouch.sources import SOURCES, open_source
from smarttouch.sources.source_contract import Device, Pose, Source

if TYPE_CHECKING:
    from evdev import InputDevice

_NOT_IN_URLS = ("span_mm", "lane_mm", "origin_mm")
"""Options of a sweep that follow from the texture."""


class HandMotion(Device, ABC):
    """Source of the displacement of a hand, opened by its URL.

    It starts at `origin_mm` of a texture, from its top left corner, known after the first read; in
    the middle if that is None. `force_n` is that of the finger at the last read, where
    `knows_force`.
    """

    duration_s: float | None = None  # duration of the motion; None if it never ends by itself
    resolution_mm: float = 0.0
    """Resolution of the motion: at rest it may jump to and fro by so much."""

    def __init__(self, title: str) -> None:
        super().__init__(title)
        self.knows_force = self.measures_force = False
        self.force_n: float = math.nan
        self.origin_mm: tuple[float, float] | None = None

    @abstractmethod
    def read(self, time_ns: int) -> tuple[float, float] | None:
        """Return the displacement from the start, right and down, mm; None at the end."""


def open_motion(url: str, **options: Any) -> HandMotion:
    """Open ``sweep:``, ``evdev:DEVICE``, ``path:CSV``, or any source with a pose.

    Options may stand in the URL, as in ``sweep:?speed_mm_s=20``; None is an option not given.
    """
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


_PATH_RESOLUTION_MM = 0.01  # resolution of recorded paths; an estimate of ours


def open_path(rest: str) -> "PathMotion":
    """Open ``path:CSV``."""
    if not rest:
        raise SourceError("path: names no file: give one, as in path:way.csv")
    return PathMotion(Path(rest))


class PathMotion(HandMotion):
    """Motion along the points of a table, in straight lines.

    The heading of the CSV file names the columns ``time_s``, ``x_mm`` and ``y_mm`` (on the texture,
    from its top left corner) and may name ``force_n``; others are not used.
    """

    resolution_mm = _PATH_RESOLUTION_MM

    def __init__(self, path: Path) -> None:
        super().__init__(f"the way of {path.name}")
        columns = read_csv(path, SourceError, ("time_s", "x_mm", "y_mm"), ("force_n",))
        self.knows_force: bool = "force_n" in columns
        table = np.column_stack([*columns.values()])
        table[:, 0] -= table[0, 0]
        self._table = table
        self.duration_s: float = float(table[-1, 0])
        self.origin_mm: tuple[float, float] = (float(table[0, 1]), float(table[0, 2]))

    def read(self, time_ns: int) -> tuple[float, float] | None:
        """Return the displacement from the first point; None after the last."""
        time_s, times = time_ns / 1e9, self._table[:, 0]
        if time_s > times[-1]:
            return None
        x, y, *force = (float(np.interp(time_s, times, column)) for column in self._table.T[1:])
        if force:
            self.force_n: float = max(0.0, force[0])
        assert self.origin_mm is not None
        return x - self.origin_mm[0], y - self.origin_mm[1]


_IMAGE_RESOLUTION_MM = 0.02  # jitter at rest of motion found in images; an estimate of ours


def open_posed_source(url: str, *, profile: Profile | None = None) -> "SourceMotion":
    """Open any source that has a pose; its optics are electric-mouse's if none are given."""
    return SourceMotion(open_source(url, profile or load_profile(DEFAULT_PROFILE)))


class SourceMotion(HandMotion):
    """Motion by the pose of a source, which is closed with it."""

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
        """Return how far the source is from where it was first; None after its end."""
        frame = self._source.read(time_ns)
        if frame is None:
            return None
        if self._first is None:
            self._first = frame.pose
        # What was seen last may be gone: whether the finger is still there is unknown.
        self.force_n: float = math.nan if frame.stale else frame.force_n
        return frame.pose.x_mm - self._first.x_mm, frame.pose.y_mm - self._first.y_mm

    def close(self) -> None:
        """Close the source."""
        self._source.close()


USUAL_MM_S = 40.0
SLOWEST_MM_S, FASTEST_MM_S = 0.1, 1000.0
START_S = 0.75  # time of rest before the first stroke: the hand is there before it moves
REST_S = 0.3  # time of rest between two strokes
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
    """Open ``sweep:`` or ``sweep:ROUNDS``; options are those of `SweepMotion`, and its origin."""
    if rest and not (rest.isdecimal() and 0 < int(rest) <= _MOST_ROUNDS):
        raise SourceError(
            f"sweep:{rest} is no number of rounds: give 1 to {_MOST_ROUNDS}, as in sweep:3"
        )
    motion = SweepMotion(speed_mm_s, span_mm, lane_mm, int(rest or USUAL_ROUNDS))
    motion.origin_mm = origin_mm
    return motion


def strokes_over(size_mm: tuple[float, float], array_mm: tuple[float, float]) -> dict[str, Any]:
    """Return options of strokes that take every electrode over a texture, width by height."""
    (width, height), (across, down) = size_mm, array_mm
    return {
        "span_mm": (width + across, height),
        "lane_mm": down,
        "origin_mm": (-across / 2, min(down, height) / 2),
    }


class SweepMotion(HandMotion):
    """Strokes over an area, lane by lane, and back the same way; rests between strokes."""

    def __init__(
        self,
        speed_mm_s: float = USUAL_MM_S,  # of every stroke
        span_mm: tuple[float, float] = (60.0, 0.0),  # width and height of the area
        lane_mm: float = 16.0,  # largest distance of lanes
        rounds: int = USUAL_ROUNDS,  # number of rounds, forth and back
    ) -> None:
        require_within(SourceError, "speed_mm_s", speed_mm_s, SLOWEST_MM_S, FASTEST_MM_S)
        super().__init__(f"a virtual hand at {speed_mm_s:g} mm/s")
        points = _round_trip(span_mm, lane_mm)
        if rounds * len(points) > _MOST_STROKES:
            raise SourceError(
                f"{rounds} rounds of {len(points) // 2} lanes are more strokes than "
                f"{_MOST_STROKES}: ask for fewer"
            )
        self._table = _timed(np.vstack([points[:1], *[points[1:]] * rounds]), speed_mm_s)
        self.duration_s: float = float(self._table[-1, 0])

    def read(self, time_ns: int) -> tuple[float, float] | None:
        """Return the position of the hand at a time; None after the last rest."""
        time_s = time_ns / 1e9
        if time_s > self._table[-1, 0]:
            return None
        x, y = (float(np.interp(time_s, self._table[:, 0], column)) for column in self._table.T[1:])
        return x, y


def _round_trip(span_mm: tuple[float, float], lane_mm: float) -> NDArray[np.float64]:
    """Return the corners of the path through all lanes and back, (N, 2) mm."""
    width_mm, height_mm = span_mm
    lanes = max(1, math.ceil(height_mm / lane_mm - 0.15)) if height_mm > lane_mm else 1
    forth = [
        (x, y)
        for lane, y in enumerate(np.linspace(0, max(0.0, height_mm - lane_mm), lanes))
        for x in ((0.0, width_mm) if lane % 2 == 0 else (width_mm, 0.0))
    ]
    return np.array(forth + forth[-2::-1])


def _timed(points: NDArray[np.float64], speed_mm_s: float) -> NDArray[np.float64]:
    """Return the times of arrival at and departure from each point, (2 N, 3): s, mm, mm."""
    strokes_s = np.hypot(*np.diff(points, axis=0).T) / speed_mm_s
    comes = np.concatenate([[0.0], START_S + np.cumsum(strokes_s + REST_S) - REST_S])
    leaves = comes + REST_S
    leaves[0] = START_S
    times = np.column_stack([comes, leaves]).ravel()
    return np.column_stack([times, np.repeat(points, 2, axis=0)])


USUAL_CPI = 800.0  # default counts per inch of most mice
_FOLDER = Path("/dev/input")
_WAIT_S = 0.1
_LOST = "some motion of the mouse was lost: the machine is too busy"
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
    for path in sorted(evdev.list_devices(), key=lambda name: (len(name), name)):
        with contextlib.suppress(OSError):
            device: InputDevice[str] = evdev.InputDevice(path, readonly=True)
            if _is_mouse(device):
                return device
            device.close()
    raise SourceError(f"no mouse among what you may read in {_FOLDER}: plug one in, or {_GROUP}")


def _is_mouse(device: "InputDevice[str]") -> bool:
    from evdev import ecodes

    moves = device.capabilities().get(ecodes.EV_REL, [])
    return ecodes.REL_X in moves and ecodes.REL_Y in moves


def _evdev() -> Any:
    return import_extra("evdev", "evdev:, on Linux alone,", "mouse", SourceError)
