"""Arrays in NumPy's files, checked before memory is taken for them."""

import io
import math
import zipfile
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from smarttouch.files import MOST_BANK_BYTES

_LONGEST_HEADER = 10_000
_MOST_ARRAYS = 1000


def read_array(file: BinaryIO, size: int) -> NDArray[Any]:
    """Return the array of a ``.npy`` file of ``size`` bytes, read from its beginning.

    Raises ValueError if it is no such file, is cut, would have to be unpickled or is too large.
    """
    try:
        version = np.lib.format.read_magic(file)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        shape, by_column, kind = read_header(file, max_header_size=_LONGEST_HEADER)
    except Exception as error:
        # The header is Python source: its damages are those of a parser.
        raise ValueError(f"its header is damaged ({type(error).__name__})") from None
    if kind.hasobject:
        raise ValueError("it holds Python objects, which are not read")
    claimed = math.prod(shape) * kind.itemsize
    if min(shape, default=0) < 0 or claimed > min(size, MOST_BANK_BYTES):
        raise ValueError(f"it claims {claimed / 1e6:,.1f} MB")
    data = file.read(claimed)
    if len(data) != claimed:
        raise ValueError("it is cut")
    sides = [int(side) for side in shape]
    return np.ndarray(sides, kind, bytearray(data), order="F" if by_column else "C")


def read_arrays(file: BinaryIO) -> dict[str, NDArray[Any]]:
    """Return the arrays of an ``.npz`` archive by name; ValueError if damaged or too large."""
    try:
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            size = sum(each.file_size for each in members)
            if len(members) > _MOST_ARRAYS or size > MOST_BANK_BYTES:
                raise ValueError(f"it claims {len(members)} arrays of {size / 1e6:,.1f} MB")
            return {each.filename.removesuffix(".npy"): _member(archive, each) for each in members}
    except ValueError:
        raise
    except Exception as error:
        # A damaged archive fails in a dozen ways, down to those of its compression.
        raise ValueError(f"it is damaged ({type(error).__name__})") from None


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(member) as packed:
        # All of it, and what should not follow it, so that its checksum is looked at.
        data = packed.read(member.file_size + 1)
    if len(data) != member.file_size:
        raise ValueError(f"{member.filename} does not have the size that it claims")
    return read_array(io.BytesIO(data), len(data))
