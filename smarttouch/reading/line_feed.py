"""Lines for the finger, prepared ahead of it on a thread of their own."""

import atexit
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class TouchLine:
    """A line of letter shapes or Braille cells, at the size of the array."""

    image: NDArray[np.uint8]  # (H, W), dark on 255, as high as the array
    start_mm: float  # first and last place of the array's middle, from the image's left edge
    end_mm: float
    text: str = ""
    cells: str = ""


AHEAD = 30  # lines prepared in advance
BEHIND = 60  # past lines kept for going back
JOIN_S = 0.3  # longest wait at the end for a page that is being recognized


class LineFeed:
    """Takes lines from an iterator on a thread of its own, and keeps those around the finger.

    An exception of the iterator is raised by `line` when that place is reached.
    """

    def __init__(self, lines: Iterator[TouchLine]) -> None:
        self.earliest: int = 0  # index of the earliest line that is kept
        self._lines: dict[int, TouchLine] = {}
        self._count = 0
        self._reached = 0
        self._over = False
        self._closing = False
        self._error: Exception | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._take_all, args=(lines,), daemon=True)

    def start(self) -> Self:
        """Start preparing lines."""
        self._thread.start()
        return self

    def line(self, index: int) -> TouchLine | None:
        """Return a line; None if it is not ready, dropped, or there is none (see `ended`)."""
        with self._changed:
            if index >= self._count and self._error is not None:
                raise self._error
            return self._lines.get(index)

    def reach(self, index: int) -> None:
        """Prepare the lines ahead of a line, and drop those far behind it."""
        with self._changed:
            self._reached = index
            while self.earliest < min(index - BEHIND, self._count):
                del self._lines[self.earliest]
                self.earliest += 1
            self._changed.notify_all()

    def ended(self, index: int) -> bool:
        """Return whether there is no such line, and will be none."""
        with self._changed:
            return self._over and index >= self._count

    @property
    def total(self) -> int | None:
        """Number of lines, once all were prepared."""
        with self._changed:
            return self._count if self._over else None

    def wait_for(self, index: int, timeout_s: float | None = None) -> TouchLine | None:
        """Return a line as soon as it is ready; None if there is none, or not in time."""
        with self._changed:
            self._changed.wait_for(lambda: self._over or index < self._count, timeout_s)
        return self.line(index)

    def wait_for_end(self, timeout_s: float | None = None) -> bool:
        """Return whether all lines were prepared in time; those far ahead wait for the finger."""
        with self._changed:
            return self._changed.wait_for(lambda: self._over, timeout_s)

    def close(self) -> None:
        """Stop preparing, and close the source of the lines."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join(JOIN_S)
        if self._thread.is_alive():
            # An interpreter that exits while a library works on a thread aborts.
            atexit.register(self._thread.join)

    def _take_all(self, lines: Iterator[TouchLine]) -> None:
        try:
            for line in lines:
                with self._changed:
                    self._lines[self._count] = line
                    self._count += 1
                    self._changed.notify_all()
                    self._changed.wait_for(
                        lambda: self._closing or self._count <= self._reached + AHEAD
                    )
                    if self._closing:
                        break
        except Exception as error:
            self._error = error
        finally:
            with self._changed:
                self._over = True
                self._changed.notify_all()
