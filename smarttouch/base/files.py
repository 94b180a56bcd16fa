"""Functions that read files up to a size limit, write private files, and find shipped data."""

import contextlib
import csv
import io
import math
import os
import re
import stat
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from smarttouch.base.errors import SmartTouchError
from smarttouch.base.posix import (
    O_BINARY,
    O_NOCTTY,
    O_NONBLOCK,
    fcntl,
    try_lock,
    user_number,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MOST_TABLE_BYTES = 16_000_000
"""Size limit of CSV and JSON files."""
MOST_TOML_BYTES = 1_000_000
"""Size limit of TOML files, because parsing takes seconds per megabyte. A profile of 1000
electrodes needs a tenth of this size."""
MOST_ARRAY_BYTES = 256_000_000  # size limit of files with NumPy arrays
MOST_BANK_BYTES = 700_000_000
"""Size limit of kernel banks and of recordings of serial lines. The bank of 4,096 electrodes has
605 MB before compression."""
MOST_DOCUMENT_BYTES = 2_000_000_000  # size limit of images, PDFs and videos


def require_file(path: Path, error: type[SmartTouchError], most_bytes: int) -> None:
    """Raise an error unless a path is a regular file of at most ``most_bytes``."""
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError):
        raise error(f"no file {path}: check its name") from None
    except OSError as failure:
        raise unreadable(error, path, failure) from None
    if not stat.S_ISREG(status.st_mode):
        kind = "folder" if stat.S_ISDIR(status.st_mode) else "pipe or device"
        raise error(f"{path} is a {kind}: give a file")
    if status.st_size > most_bytes:
        size_mb, most_mb = status.st_size / 1e6, most_bytes / 1e6
        message = f"{path} has {size_mb:,.1f} MB: give a file of at most {most_mb:,.0f} MB"
        raise error(message)


def require_replaceable(path: Path, error: type[SmartTouchError]) -> None:
    """Raise an error if a new file would replace something other than a file, such as a device."""
    if path.exists() and not path.is_file():
        raise error(f"cannot write {path}: it is not a file; give another name")


def open_file(path: Path, error: type[SmartTouchError], most_bytes: int) -> BinaryIO:
    """Open a regular file for reading, see `require_file`.

    Devices and pipes are refused: opening a pipe can block, and opening a port can reset a board.
    """
    require_file(path, error, most_bytes)
    try:
        return path.open("rb")
    except OSError as failure:
        raise unreadable(error, path, failure) from None


def read_bytes(
    path: Path, error: type[SmartTouchError], most_bytes: int = MOST_TABLE_BYTES
) -> bytes:
    """Read a file. Raises errors like `open_file`."""
    try:
        with open_file(path, error, most_bytes) as file:
            return file.read()
    except OSError as failure:
        raise unreadable(error, path, failure) from None


def read_text(path: Path, error: type[SmartTouchError], most_bytes: int = MOST_TABLE_BYTES) -> str:
    """Read a UTF-8 text, without its byte-order mark. Raises errors like `open_file`."""
    return decoded(read_bytes(path, error, most_bytes), path, error)


def decoded(data: bytes, path: Path, error: type[SmartTouchError]) -> str:
    """Decode the UTF-8 text of a file, without its byte-order mark."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as failure:
        message = f"{path} is not a text in UTF-8 (byte {failure.start + 1}): save it as UTF-8"
        raise error(message) from None


_DOCUMENT = r"brf|csv|docx?|epub|html?|jpe?g|md|mkv|mp4|odt|pdf|png|rtf|tiff?|txt|webp"
_FILE_NAME = re.compile(
    rf"(?:\.{{0,2}}/\S+|\S*\.[A-Za-z]\w{{1,3}}|[^\n]*\.(?:{_DOCUMENT}|xhtml|markdown))"
    r"(?P<options>\?[a-z_]+(?:=[^\s&]*)?(?:&[a-z_]+(?:=[^\s&]*)?)*)?",
    re.IGNORECASE,
)


def named_file(name: str, error: type[SmartTouchError]) -> Path | None:
    """Return the file with this name; None if the name looks like a text and not like a file name.
    Raise an error if it looks like a file name, but there is no such file."""
    there = file_at(name)
    if there is None and (words := _FILE_NAME.fullmatch(name)):
        file = name.removesuffix(words["options"] or "")
        message = f"there is no file {file}: check its name, or give text:{name} for these words"
        raise error(message)
    return there


def file_at(name: str) -> Path | None:
    """Return the file or folder with this name, or None."""
    try:
        return Path(name) if name and Path(name).exists() else None
    except (OSError, ValueError):
        return None


def read_toml(path: Path, error: type[SmartTouchError]) -> dict[str, Any]:
    """Read a TOML file, without validation."""
    text = read_text(path, error, MOST_TOML_BYTES)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as failure:
        raise error(f"{path} is not a readable TOML file: {failure}") from None


def owner_only(path: str, flags: int) -> int:
    """Opener for `open`. Only the owner of a new file can access it."""
    return os.open(path, flags | O_NOCTTY | O_BINARY, 0o600)


def make_folder(path: Path) -> None:
    """Create a folder and its parents, accessible only by their owner. Existing folders are not
    changed. Raises errors like `Path.mkdir`."""
    if not path.is_dir():
        make_folder(path.parent)
        path.mkdir(0o700, exist_ok=True)


def write_bytes(path: Path, data: bytes, error: type[SmartTouchError] = SmartTouchError) -> None:
    """Write a file atomically: it is complete on disk before it replaces an existing file. Devices
    and pipes are written directly."""
    try:
        # Append to /dev/stdout: it may be a file to which other programs write as well.
        if path.exists() and (not path.is_file() or path.parent == Path("/dev")):
            # `owner_only` sets O_NOCTTY: a terminal must not become the controlling terminal.
            with open(path, "ab", opener=owner_only) as file:
                file.write(data)
        else:
            replace_file(Path(os.path.realpath(path)), data)
    except ValueError:
        raise error(f"cannot write {path}: give a valid file name") from None
    except OSError as failure:
        raise unwritable(error, path, failure) from None


def replace_file(path: Path, data: bytes) -> None:
    """Replace a file atomically: the new content is complete on disk before it appears."""
    number, draft = tempfile.mkstemp(prefix=".", suffix=".draft", dir=path.parent)
    try:
        with os.fdopen(number, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(number)
        Path(draft).replace(path)
    except BaseException:
        Path(draft).unlink(missing_ok=True)
        raise


def open_alone(path: Path, error: type[SmartTouchError]) -> BinaryIO:
    """Open a file for reading and writing with an exclusive lock; create it if it is missing.

    Afterwards only the file's owner may read it. While it is open in this program, other
    programs that call this function get an error. File systems without locks give no protection.
    """
    while True:
        try:
            flags = os.O_RDWR | os.O_CREAT | O_NONBLOCK
            file = os.fdopen(owner_only(os.fspath(path), flags), "r+b")
            status = os.fstat(file.fileno())
            if user_number() is not None and status.st_mode & 0o077:
                # Some file systems have no permissions: ignore the error if the user owns the file.
                with contextlib.suppress(*[OSError] * (status.st_uid == user_number())):
                    os.fchmod(file.fileno(), 0o600)
        except OSError as failure:
            raise unwritable(error, path, failure) from None
        if fcntl is not None and not try_lock(file.fileno()):
            file.close()
            raise error(
                f"{path} is in use by another run: wait until it has ended, or give another file"
            )
        # If another program removed the file before it was locked, try again with a new file.
        if path.exists() and os.path.samestat(path.stat(), os.fstat(file.fileno())):
            return file
        file.close()


def unreadable(error: type[SmartTouchError], path: Path, failure: OSError) -> SmartTouchError:
    """Return the error for a file that cannot be read."""
    return error(f"cannot read {path}: {failure.strerror}")


def unwritable(error: type[SmartTouchError], path: Path, failure: OSError) -> SmartTouchError:
    """Return the error for a file that cannot be written."""
    return error(f"cannot write {path}: {failure.strerror}")


def require_folder(path: Path | None) -> None:
    """Raise SmartTouchError if an output path is a folder, or if its folder does not exist."""
    if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
        message = f"cannot write {path}: give a file in a folder that exists"
        raise SmartTouchError(message)


def write_json(path: Path, figures: Any) -> None:
    """Write values as JSON; NaN and infinite numbers become null."""
    from pydantic_core import to_json  # imported here so that --help and short commands start fast

    write_bytes(path, to_json(figures, indent=2, inf_nan_mode="null") + b"\n")


def data_folder(name: str) -> Path:
    """Return a shipped data folder, ``calibration`` or ``sample_images``.

    In a wheel the folders are inside the package; in a checkout they are beside it.
    """
    from importlib.resources import files

    package = Path(str(files("smarttouch"))).resolve()
    inside = package / name
    return inside if inside.is_dir() else package.parent / name


def read_csv(
    path: Path,
    error: type[SmartTouchError],
    needed: Sequence[str],
    optional: Sequence[str] = (),
    *,
    rising: bool = True,
) -> "dict[str, NDArray[np.float64]]":
    """Read columns of a CSV file as numbers: the ``needed`` ones, and ``optional`` ones if present.

    If ``rising``, the first column must increase. Raises ``error``.
    """
    import numpy as np  # imported here so that --help and short commands start fast

    try:
        reader = csv.reader(io.StringIO(read_text(path, error), newline=""))
        lines = [(reader.line_num, row) for row in reader if any(map(str.strip, row))]
    except csv.Error as failure:
        raise error(f"{path} is not a CSV file ({failure}): save it as CSV in UTF-8") from None
    head = [cell.strip() for cell in lines[0][1]] if lines else []
    names = [*needed, *(name for name in optional if name in head)]
    if not set(needed) <= set(head):
        raise error(
            f"{path} has the columns {', '.join(head) or '(none)'}: its first line must name "
            f"{', '.join(needed)}"
        )
    rows: list[list[float]] = []
    for line, cells in lines[1:]:
        try:
            rows.append(_numbers(head, cells, names))
            if rising and len(rows) > 1 and rows[-1][0] <= rows[-2][0]:
                now, before = rows[-1][0], rows[-2][0]
                raise ValueError(
                    f"{names[0]} must increase, but {now:g} follows {before:g}: correct it"
                )
        except ValueError as wrong:
            raise error(f"{path}, line {line}: {wrong}") from None
    if len(rows) < 2:
        raise error(f"{path} has {len(rows)} rows of numbers: give 2 or more")
    return dict(zip(names, np.array(rows).T.copy(), strict=True))


def _numbers(head: list[str], cells: list[str], names: list[str]) -> list[float]:
    # A decimal comma splits a number into two cells and shifts all later cells.
    if any(map(str.strip, cells[len(head) :])):
        raise ValueError(
            f"the line has {len(cells)} cells, but the heading has {len(head)}: remove cells, or "
            "write 7.5 instead of 7,5"
        )
    row = dict(zip(head, cells, strict=False))
    for name in names:
        if math.isnan(finite(row.get(name, ""))):
            raise ValueError(f"{name} is {row.get(name, '')!r}, not a number: correct it")
    return [float(row[name]) for name in names]


def finite(text: str) -> float:
    """Parse a number; return NaN if it is missing, invalid or infinite."""
    try:
        number = float(text)
    except ValueError:
        return math.nan
    return number if math.isfinite(number) else math.nan
