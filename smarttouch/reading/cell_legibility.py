"""Legibility of Braille: the part of the cells that was delivered correctly."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

from smarttouch.braille.tables import open_table
from smarttouch.reading.braille import Braille
from smarttouch.reading.deliver import Reading, deliver_lines
from smarttouch.reading.source import Source

_Item = TypeVar("_Item")
Progress = Callable[[int, int], None]
"""Callback with the number of finished lines and of all."""


def no_progress(_done: int, _total: int) -> None:
    """Report nothing."""


@dataclass(frozen=True)
class BrailleLegibility:
    """Legibility of Braille: wanted and delivered cells, a line each, and the part that differs."""

    cell_error_rate: float
    cells: int
    lines: int
    wanted: str
    delivered: str
    text: str | None


def legibility_of_braille(
    source: Source, reading: Reading, braille: Braille, progress: Progress = no_progress
) -> BrailleLegibility:
    """Deliver cells, and decode the delivered dots."""
    profile = reading.profile
    lines = list(braille.lines(source, profile))
    pictures = [
        each.picture for each in collect(deliver_lines(lines, reading), 0, len(lines), progress)
    ]
    wanted: list[str] = []
    delivered: list[str] = []
    for line, picture in zip(lines, pictures, strict=True):
        layout = braille.layout(profile, line.cells)
        wanted += line.cells
        delivered += layout.decode(picture, line.cells, apart=reading.motion.gaps)
    count = sum(map(len, wanted))
    wrong = sum(
        one != other
        for pair in zip(wanted, delivered, strict=True)
        for one, other in zip(*pair, strict=True)
    )
    table = open_table(braille.table)
    shown = "\n".join(delivered)
    return BrailleLegibility(
        cell_error_rate=wrong / count,
        cells=count,
        lines=len(wanted),
        wanted="\n".join(wanted),
        delivered=shown,
        text=table.to_text(shown) if table.code.goes_back else None,
    )


def collect(lines: Iterable[_Item], before: int, total: int, progress: Progress) -> list[_Item]:
    """Return all lines, or fingers, and report each as it comes."""
    found: list[_Item] = []
    for line in lines:
        found.append(line)
        progress(before + len(found), total)
    return found
