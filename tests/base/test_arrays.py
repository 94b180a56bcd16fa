"""No file of arrays takes memory that it does not have, or is unpickled."""

import io
import os
import random
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest

from smarttouch.base.tables import read_array, read_arrays

from ..whole import WHOLE

MUTANTS = int(os.environ.get("SMARTTOUCH_MUTANTS", "150" if WHOLE else "60"))
KINDS = (np.float64, np.float32, np.int8, np.uint16, "<U9", "S3", bool)


@pytest.fixture
def traced():
    tracemalloc.start()
    yield
    tracemalloc.stop()


def packed(**arrays):
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file


def plain(array):
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", [(), (0,), (3,), (2, 3), (4, 1, 2)])
def test_arrays_come_back(kind, shape):
    values = np.arange(int(np.prod(shape)) or 1)[: int(np.prod(shape))].reshape(shape).astype(kind)
    for array in (values, np.asfortranarray(values)):
        data = plain(array)
        found = read_array(io.BytesIO(data), len(data))
        assert found.dtype == array.dtype
        assert np.array_equal(found, array)
        both = read_arrays(packed(a=array, b=array))
        assert set(both) == {"a", "b"}
        assert np.array_equal(both["b"], array)


class MakesAFolder:
    """Object with a side effect when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def test_objects_are_not_unpickled(tmp_path):
    path = tmp_path / "made"
    data = plain(np.array([MakesAFolder(path)], object))
    with pytest.raises(ValueError):
        read_array(io.BytesIO(data), len(data))
    assert not path.exists()
    np.load(io.BytesIO(data), allow_pickle=True)
    assert path.exists()


def header(text):
    text = text.ljust(117).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


@pytest.mark.parametrize(
    "shape", ["(10**30,)", "(1000000000000,)", "(-5,)", "(" * 5000, "(1, 'a')", "1e9"]
)
def test_claims_are_not_believed(shape, traced):
    data = header(f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}") + bytes(80)
    with pytest.raises(ValueError):
        read_array(io.BytesIO(data), len(data))
    assert tracemalloc.get_traced_memory()[1] < 10**7


def test_a_small_archive_of_much_is_not_unpacked(traced):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("a.npy", bytes(30_000_000))
    assert len(file.getvalue()) < 200_000
    tracemalloc.reset_peak()
    with pytest.raises(ValueError):
        read_arrays(file, 10**7)
    assert tracemalloc.get_traced_memory()[1] < 10**6


def test_an_archive_that_lies_about_its_size():
    data = bytearray(packed(a=np.arange(5000.0)).getvalue())
    size = struct.pack("<I", 5000 * 8 + 128)
    assert data.count(size) >= 1
    with pytest.raises(ValueError):
        read_arrays(io.BytesIO(data.replace(size, struct.pack("<I", 200))))


def test_no_mutant_is_anything_but_a_value_error():
    whole = packed(key=np.array("x"), a=np.arange(40.0).reshape(5, 8)).getvalue()
    taken = 0
    for seed in range(MUTANTS):
        chance, data = random.Random(seed), bytearray(whole)
        for _ in range(chance.choice((1, 2, 9))):
            data[chance.randrange(len(data))] = chance.randrange(256)
        if chance.random() < 0.2:
            del data[chance.randrange(len(data)) :]
        try:
            found = read_arrays(io.BytesIO(data))
        except ValueError:
            continue
        taken += 1
        for each in found.values():
            assert each.tobytes() in (np.arange(40.0).tobytes(), np.array("x").tobytes())
    assert taken < MUTANTS / 2
