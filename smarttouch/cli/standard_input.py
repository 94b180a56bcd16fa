"""Standard input wherever a command reads a text or a page: ``-`` in place of its name."""

import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from smarttouch.errors import SmartTouchError

_MOST_BYTES = 256_000_000
_BEGINNINGS = {
    b"%PDF": ".pdf",
    b"\x89PNG": ".png",
    b"\xff\xd8\xff": ".jpg",
    b"II*\0": ".tif",
    b"MM\0*": ".tif",
}


def or_standard_input(ctx: typer.Context, given: str | None) -> str | None:
    """Return the value of an argument; for ``-``, a file with the content of standard input.

    ``page:-`` stands for the URL of such a file. It is removed when the command ends.
    """
    prefix, dash, options = (given or "").partition("-")
    if not dash or prefix not in ("", "page:") or (options and not options.startswith("?")):
        return given
    if options and not prefix:
        return given
    return f"{prefix}{ctx.with_resource(_file_of_standard_input())}{options}"


@contextmanager
def _file_of_standard_input() -> Iterator[Path]:
    stream = getattr(sys.stdin, "buffer", None)
    data = sys.stdin.read().encode() if stream is None else stream.read(_MOST_BYTES + 1)
    if not data:
        raise SmartTouchError(
            "standard input holds nothing: give a file, or pipe a text or a page into the command",
            about="standard input",
        )
    if len(data) > _MOST_BYTES:
        raise SmartTouchError(
            f"standard input holds more than {_MOST_BYTES / 1e6:,.0f} MB: give a file",
            about="standard input",
        )
    with tempfile.TemporaryDirectory(prefix="smarttouch-") as folder:
        path = Path(folder) / f"standard input{_ending(data)}"
        path.write_bytes(data)
        yield path


def _ending(data: bytes) -> str:
    """Return the suffix of a file by its first bytes; that of a text if they are unknown."""
    if b"<pef" in data[:1000]:
        return ".pef"
    return next((each for start, each in _BEGINNINGS.items() if data.startswith(start)), ".txt")
