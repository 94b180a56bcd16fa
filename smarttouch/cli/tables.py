"""Tables on the terminal."""

from collections.abc import Iterable, Sequence
from typing import Any

from smarttouch import terminal


def print_table(
    rows: Iterable[Sequence[Any]],
    heading: Sequence[str] = (),
    *,
    title: str | None = None,
    note: str | None = None,
    ruled: bool = False,
    left: int = 1,
) -> None:
    """Print a table.

    Parameters
    ----------
    rows : iterable of sequences
        Of texts.
    heading : sequence of str
        Names of the columns; no line of them if there are none.
    title, note : str, optional
        Above and below.
    ruled : bool
        Draw lines around it.
    left : int
        So many columns keep to the left, the others to the right.
    """
    from rich.box import HEAVY_HEAD
    from rich.table import Table

    rows = list(rows)
    table = Table(
        title=title,
        title_justify="left",
        box=HEAVY_HEAD if ruled else None,
        pad_edge=ruled,
        show_header=bool(heading),
    )
    for column in range(len(heading or max(rows, key=len, default=()))):
        table.add_column(
            heading[column] if heading else "",
            justify="left" if column < left else "right",
            no_wrap=ruled or column == 0,
            overflow="fold",
        )
    for row in rows:
        table.add_row(*row)
    console = terminal.console()
    console.print(table)
    if note is not None:
        console.print(note, style="dim", soft_wrap=True)
