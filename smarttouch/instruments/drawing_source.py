"""``draw:``: patterns of a library, of a file or drawn by a user, alone or played as a list."""

import base64
import json
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.electrodes import ElectrodeArray
from smarttouch.base.errors import SmartTouchError, SourceError
from smarttouch.base.files import open_file, unreadable, write_bytes
from smarttouch.imaging.array_window import reading_force_n
from smarttouch.profile import Profile
from smarttouch.reading.letter_shapes import draw_letter
from smarttouch.sources.source_contract import Stimulus, StimulusSource

SHORTEST_MS, LONGEST_MS = 20, 60_000
USUAL_MS = 500
_STEP_MS = 150
_SECTORS = 8

Levels = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Pattern:
    """Activation of the electrodes for a while."""

    level: Levels  # (E,) uint8: 255 is full activation
    duration_ms: int = USUAL_MS


def library(electrodes: ElectrodeArray) -> dict[str, tuple[Pattern, ...]]:
    """Return the patterns that an array has room for, by their names."""
    half = np.maximum(np.ptp(electrodes.position_mm, axis=0) / 2, 1e-9)
    x, y = (electrodes.position_mm / half).T
    # Half a cell, and a bit for what is rounded.
    cell_x, cell_y = np.minimum(np.array(electrodes.cell_mm) / 2 / half, 1) + 1e-6
    far, turn = np.hypot(x, y), np.mod(np.arctan2(y, x), 2 * np.pi)
    still = {
        "all": far < np.inf,
        "point": far == far.min(),
        "row": np.abs(y) <= cell_y,
        "column": np.abs(x) <= cell_x,
        "cross": (np.abs(y) <= cell_y) | (np.abs(x) <= cell_x),
        "diagonal": np.abs(x - y) <= max(cell_x, cell_y),
        "frame": np.maximum(np.abs(x), np.abs(y)) >= 1 - 1e-6,
        "ring": np.abs(far - 0.7) <= max(cell_x, cell_y),
        "left half": x < 0,
        "upper half": y < 0,
    }
    found = {
        **{name: (_pattern(on),) for name, on in still.items()},
        "sweep right": _moving(np.unique(x.round(6)), lambda at: np.abs(x - at) < 1e-5),
        "sweep down": _moving(np.unique(y.round(6)), lambda at: np.abs(y - at) < 1e-5),
        "turn": _moving(
            np.arange(_SECTORS) * 2 * np.pi / _SECTORS,
            lambda at: np.mod(turn - at, 2 * np.pi) < 2 * np.pi / _SECTORS,
        ),
    }
    there = {name: tuple(one for one in each if one.level.any()) for name, each in found.items()}
    return {name: each for name, each in there.items() if each}


def _pattern(on: NDArray[np.bool_], duration_ms: int = USUAL_MS) -> Pattern:
    return Pattern(np.where(on, 255, 0).astype(np.uint8), duration_ms)


def _moving(places: NDArray[Any], there: Callable[[float], Any]) -> tuple[Pattern, ...]:
    return tuple(_pattern(there(float(each)), _STEP_MS) for each in places)


MOST_PATTERNS = 500
_MOST_BYTES = 20_000_000


def open_draw(rest: str, profile: Profile) -> "DrawSource":
    """Open ``draw:``, or ``draw:FILE.json`` with patterns as `write_patterns` writes them."""
    source = DrawSource(profile)
    if rest:
        source.patterns = read_patterns(Path(rest), profile)
    return source


class DrawSource(StimulusSource):
    """Source of the drawing of a page, or of a list of patterns one after another."""

    frames: int

    knows_force = True

    def __init__(self, profile: Profile) -> None:
        super().__init__("drawing")
        self.patterns: list[Pattern] = []
        self.changes: int = 1
        self.canvas: DrawSource = self
        self._profile = profile
        self._level = np.zeros(len(profile.electrodes), np.uint8)
        self._press_n, self._library = reading_force_n(profile), library(profile.electrodes)
        self._playing, self._loops, self._begun_ns = False, False, -1
        self._at = 0
        self._shown: Levels | None = None
        self._notice = ""
        # Letters and files take long; the loop waits only for `_lock`, which guards what is shown.
        self._turn, self._lock = threading.Lock(), threading.Lock()

    def read(self, time_ns: int) -> Stimulus:
        with self._lock:
            level = self._now(time_ns)
        if self._shown is None or not np.array_equal(level, self._shown):
            self._shown = level
            self.frames += 1
        activation = np.empty((len(Afferent), len(level)), np.float32)
        activation[:] = level / np.float32(255)
        return Stimulus(activation, time_ns, self._press_n, number=self.frames - 1)

    def _now(self, time_ns: int) -> Levels:
        if not self._playing:
            return self._level
        if self._begun_ns < 0:
            self._begun_ns = time_ns
        ends_ms = np.cumsum([each.duration_ms for each in self.patterns])
        since_ms = (time_ns - self._begun_ns) / 1e6
        if since_ms >= ends_ms[-1] and not self._loops:
            self._halt()
            return self._level
        at = int(np.searchsorted(ends_ms, since_ms % ends_ms[-1], side="right"))
        if at != self._at:
            self._at = at
            self.changes += 1
        return self.patterns[at].level

    def message(self) -> dict[str, Any]:
        """Return the state that a page shows."""
        with self._lock:
            return {
                "changes": self.changes,
                "level": _text(self._level),
                "patterns": [
                    {"level": _text(each.level), "ms": each.duration_ms} for each in self.patterns
                ],
                "playing": self._at if self._playing else None,
                "loops": self._loops,
                "said": self._notice,
                "library": list(self._library),
            }

    def draw(self, words: str) -> None:
        """Execute a page's request; see the methods whose names begin with ``_do_``."""
        verb, _, rest = words.partition(" ")
        does = getattr(self, f"_do_{verb}", None) if verb.isidentifier() else None
        if does is None:
            raise ValueError(words)
        with self._turn:
            self._notice = ""
            try:
                does(rest)
            except SmartTouchError as error:
                self._notice = str(error)
            with self._lock:
                self.changes += 1

    def _do_level(self, text: str) -> None:
        """Replace the drawing by the activation of all electrodes, bytes in base64."""
        self._show(_levels(text, len(self._level)))

    def _do_letter(self, letter: str) -> None:
        if len(letter) != 1 or not letter.isprintable() or letter == " ":
            raise ValueError(letter)
        self._show(np.rint(255 * draw_letter(letter, self._profile)).astype(np.uint8))

    def _do_library(self, name: str) -> None:
        """Draw a pattern of the library; what moves goes to the list."""
        if name not in self._library:
            raise ValueError(name)
        chosen = self._library[name]
        self._show(chosen[0].level)
        if len(chosen) > 1:
            self._add(*chosen)

    def _do_keep(self, text: str) -> None:
        """Add the drawing to the list, for so many ms."""
        self._add(Pattern(self._level, _duration_ms(text)))

    def _do_show(self, text: str) -> None:
        """Draw a pattern of the list."""
        self._show(self.patterns[self._index(text)].level)

    def _do_drop(self, text: str) -> None:
        """Remove a pattern from the list."""
        index = self._index(text)
        with self._lock:
            self._halt()
            del self.patterns[index]

    def _do_play(self, how: str) -> None:
        """Play the list, once or in a loop."""
        if how not in ("once", "loop"):
            raise ValueError(how)
        with self._lock:
            self._halt()
            self._playing, self._loops = bool(self.patterns), how == "loop"

    def _do_halt(self, rest: str) -> None:
        """Stop the list, and show nothing."""
        if rest:
            raise ValueError(rest)
        with self._lock:
            self._halt()

    def _do_save(self, rest: str) -> None:
        """Write the list to a new file in the working directory."""
        if rest:
            raise ValueError(rest)
        path = _free_name()
        write_patterns(path, self._profile, self.patterns or [Pattern(self._level)])
        self._notice = f"saved as {path}"

    def _add(self, *patterns: Pattern) -> None:
        if len(self.patterns) + len(patterns) > MOST_PATTERNS:
            self._notice = f"the list is full: it has {MOST_PATTERNS} patterns"
            return
        with self._lock:
            self._halt()
            self.patterns += patterns

    def _show(self, level: Levels) -> None:
        with self._lock:
            self._halt()
            self._level = level

    def _halt(self) -> None:
        if self._playing:
            self._level = np.zeros_like(self._level)
            self.changes += 1
        self._playing, self._begun_ns, self._at = False, -1, 0

    def _index(self, text: str) -> int:
        if not (text.isascii() and text.isdecimal()) or int(text) >= len(self.patterns):
            raise ValueError(text)
        return int(text)

    def close(self) -> None:
        """Do nothing: nothing is open."""


def write_patterns(path: Path, profile: Profile, patterns: Sequence[Pattern]) -> None:
    """Write patterns one after another as JSON, activation from 0 to 1."""
    starts_ms = np.cumsum([0, *(each.duration_ms for each in patterns)]).tolist()
    document = {
        "profile": profile.name,
        "electrodes": [
            {"x_mm": x, "y_mm": y} for x, y in profile.electrodes.position_mm.round(6).tolist()
        ],
        "steps": [
            {"time_ms": start, "activation": (each.level / 255).round(3).tolist()}
            for start, each in zip(starts_ms, patterns, strict=False)
        ],
    }
    write_bytes(path, (json.dumps(document) + "\n").encode())


def read_patterns(path: Path, profile: Profile) -> list[Pattern]:
    """Return the patterns of a file of `write_patterns`; the last lasts as long as the one before
    it."""
    try:
        with open_file(path, SourceError, _MOST_BYTES) as file:
            document = json.loads(file.read())
        steps, electrodes = document["steps"], document["electrodes"]
        levels = [np.array(each["activation"], np.float64) for each in steps]
        begin_ms = np.array([each["time_ms"] for each in steps], np.float64)
        place = np.array([(each["x_mm"], each["y_mm"]) for each in electrodes], np.float64)
        sound = (
            len(levels) > 0
            and begin_ms.shape == (len(levels),)
            and bool(np.isfinite(begin_ms).all())
            and all(0 < each <= LONGEST_MS for each in np.diff(begin_ms))
            and all(each.shape == (len(electrodes),) for each in levels)
            and all((each >= 0).all() and (each <= 1).all() for each in levels)
        )
    except OSError as error:
        raise unreadable(SourceError, path, error) from None
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        sound = False
    if not sound:
        raise SourceError(
            f"{path} has no patterns of electrodes, each of at most {LONGEST_MS} ms: give a file "
            "that the window saved",
            about="file",
        )
    if len(levels) > MOST_PATTERNS:
        raise SourceError(
            f"{path} has {len(levels)} patterns, and a list at most {MOST_PATTERNS}: leave "
            "some out",
            about="file",
        )
    own = profile.electrodes.position_mm
    if place.shape != own.shape or not np.allclose(place, own, atol=0.01):
        raise SourceError(
            f"{path} is of {len(place)} electrodes at other places than the {len(own)} of "
            f"{profile.name}: choose the profile that it was made with",
            about="profile",
            remedy="profile",
        )
    lasts_ms = np.diff(begin_ms).tolist()
    lasts_ms.append(lasts_ms[-1] if lasts_ms else USUAL_MS)
    return [
        Pattern(np.rint(255 * level).astype(np.uint8), max(1, round(ms)))
        for level, ms in zip(levels, lasts_ms, strict=True)
    ]


def _duration_ms(text: str) -> int:
    if not (text.isascii() and text.isdecimal()) or not SHORTEST_MS <= int(text) <= LONGEST_MS:
        raise ValueError(text)
    return int(text)


def _levels(text: str, electrodes: int) -> Levels:
    level = np.frombuffer(base64.b64decode(text, validate=True), np.uint8)
    if len(level) != electrodes:
        raise ValueError(text)
    return level


def _text(level: Levels) -> str:
    return base64.b64encode(level.tobytes()).decode("ascii")


def _free_name() -> Path:
    number = 1
    while (path := Path(f"drawing-{number}.json")).exists():
        number += 1
    return path
