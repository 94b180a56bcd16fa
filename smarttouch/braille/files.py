"""Files of cells and texts, whole: what goes wrong with them becomes one sentence."""

from pathlib import Path

from smarttouch.errors import BrailleError

MOST_BYTES = 50_000_000
"""A book has a few million cells."""


def read_bytes(path: Path) -> bytes:
    """Return what a file holds.

    Raises
    ------
    BrailleError
        If it cannot be read, or is far too large.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
    except (FileNotFoundError, ValueError):
        raise BrailleError(f"no file {path}: check its name") from None
    except IsADirectoryError:
        raise BrailleError(f"{path} is a folder: give a file") from None
    except OSError as error:
        raise BrailleError(f"{path} cannot be read: {error.strerror}") from None
    if len(data) > MOST_BYTES:
        raise BrailleError(f"{path} is above {MOST_BYTES // 10**6} MB: give it in parts")
    return data


def read_text(path: Path) -> str:
    """Return a text file in UTF-8, with newlines only, and no byte-order mark.

    Raises
    ------
    BrailleError
        If it cannot be read, or is not UTF-8.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BrailleError(
            f"{path} is not a text in UTF-8 (byte {error.start + 1}): save it as UTF-8"
        ) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file.

    Raises
    ------
    BrailleError
        If it cannot be written.
    """
    try:
        path.write_bytes(data)
    except OSError as error:
        raise BrailleError(f"cannot write {path}: {error.strerror}") from None
