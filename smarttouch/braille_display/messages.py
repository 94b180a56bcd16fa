"""Messages of BRLTTY's virtual Braille display, as lines of text.

The host sends ``cells 20``, names of BRLTTY's commands, and ``quit``. BRLTTY sends the content of
the display as ``Visual "Hello"`` and ``Braille "1257|15|123|123|135"``, the dots of each cell
between bars and a space where there are none; quotes and backslashes follow a backslash.
"""

import re
from dataclasses import dataclass, replace

from smarttouch.braille.cells import BLANK

LONGEST_LINE = 16_384
"""Most bytes of a line; longer ones are dropped."""
MOST_CELLS = 255
_MESSAGE = re.compile(r'(Braille|Visual) "(.*)"')
_DOTS = re.compile(r" ?|1?2?3?4?5?6?7?8?")
_CURSOR = 0b1100_0000


@dataclass(frozen=True)
class DisplayContent:
    """Content of the display: cells, their text, the count of updates, and when it arrived."""

    cells: str = ""
    text: str = ""
    number: int = 0
    time_ns: int = 0  # of time.perf_counter_ns; 0 if unknown

    @property
    def cursor(self) -> int | None:
        """Index of the cursor, the only cell with dots 7 and 8; None without one."""
        under = [index for index, cell in enumerate(self.cells) if ord(cell) & _CURSOR == _CURSOR]
        return under[0] if len(under) == 1 else None

    @property
    def length(self) -> int:
        """Number of cells up to the last that is not blank."""
        return len(self.cells.rstrip(BLANK))

    def first_new(self, before: "DisplayContent") -> int | None:
        """Return the first cell to be presented again; None if nothing but a cursor has changed.

        A cursor at the first change or right behind it means typing: that cell; otherwise the
        line is another one, presented from its beginning.
        """
        size = max(len(self.cells), len(before.cells))
        now, former = (each.cells.ljust(size, BLANK) for each in (self, before))
        for index, (cell, other) in enumerate(zip(now, former, strict=True)):
            if (ord(cell) ^ ord(other)) & ~_CURSOR:
                cursor = self.cursor
                return index if cursor is not None and 0 <= cursor - index <= 1 else 0
        return None


class BrlttyMessages:
    """Parser of lines that arrive in pieces of any length; counts those that are no message."""

    def __init__(self) -> None:
        self.shown = DisplayContent()
        self.garbled = 0
        self._rest = b""

    def feed(self, data: bytes) -> None:
        """Parse the bytes that have arrived."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._take(line.decode("utf-8", "replace").rstrip("\r"))
        if len(self._rest) > LONGEST_LINE:
            self._rest = b""
            self.garbled += 1

    def _take(self, line: str) -> None:
        found = _MESSAGE.fullmatch(line)
        if found is None:
            # Status cells are not presented.
            self.garbled += not line.startswith("Status")
            return
        kind, content = found.groups()
        if kind == "Visual":
            self.shown = replace(self.shown, text=re.sub(r"\\(.)", r"\1", content).rstrip())
            return
        dots = content.split("|")
        if len(dots) > MOST_CELLS or not all(map(_DOTS.fullmatch, dots)):
            self.garbled += 1
            return
        cells = "".join(
            chr(ord(BLANK) + sum(1 << (int(dot) - 1) for dot in cell.strip())) for cell in dots
        )
        self.shown = replace(self.shown, cells=cells, number=self.shown.number + 1)
