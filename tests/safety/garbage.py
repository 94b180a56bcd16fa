"""Field values of wrong types, sizes and ranges, and unusual values that are valid."""

import math
from decimal import Decimal
from fractions import Fraction

import numpy as np

NUMBERS = (
    math.nan, math.inf, -math.inf, -0.0, 0, 1, -1, 0.5, 1.5, 20_000.0, 1e300, 5e-324, True, False,
    None, "20000", b"1", 1j, Fraction(1, 2), Decimal(1), [20_000], (), 2**31, 2**32, 2**61,
    2**62 - 1, 2**62, 2**63 - 1, 2**63, -(2**63), 2**64, 10**30, -(10**30), 10**400, 60_000_000,
    60_000_001, 59_999_999,
    np.int8(100), np.uint8(200), np.int16(20_000), np.uint16(20_000), np.int32(20_000),
    np.uint32(2**32 - 1), np.int64(2**63 - 1), np.int64(-(2**63)), np.uint64(2**64 - 1),
    np.uint64(20_000), np.bool_(True), np.float16(0.5), np.float32(0.1), np.float64(20_000.0),
    np.float64(math.nan), np.float32(math.inf), np.float16(math.nan), np.longdouble(1.0),
    np.longdouble(1) + np.finfo(np.longdouble).eps, np.float32(1) + np.finfo(np.float32).eps,
    1 + 2**-52, np.array(20_000), np.array([20_000]), np.array(0.5), np.datetime64(1, "ns"),
)  # fmt: skip
"""Replacements for a number."""


KINDS = (
    "int8", "uint8", "int16", "uint16", "int32", "int64", "uint64", "float16", "float32", "float64",
    "bool", "complex128", "object", "S4", ">i2", ">u2", ">f4",
)  # fmt: skip
NO_ARRAYS = (None, 0, "array", (), b"", [0, 0])


def _at_an_end(array, rng):
    """Return a copy of an array in which one element is an extreme or special value."""
    array = array.copy()
    if array.size:
        kind = array.dtype
        ends = (
            (math.nan, math.inf, -math.inf, 1.0, -1e-30, 1e-45)
            if kind.kind == "f"
            else (np.iinfo(kind).min, np.iinfo(kind).max, 0, 1)
        )
        array.flat[rng.randrange(array.size)] = rng.choice(ends)
    return array


CHANGES = (
    # Other shapes.
    lambda array, _: array[:-1],
    lambda array, _: array[None],
    lambda array, _: array.ravel() if array.ndim > 1 else array.reshape(-1, 1),
    lambda array, _: array.T[..., :-1],
    lambda array, _: np.zeros((0,) * array.ndim, array.dtype),
    # Other types.
    lambda array, rng: array.astype(rng.choice(KINDS)),
    lambda array, rng: rng.choice((*NO_ARRAYS, array.tolist(), array.data)),
    # Other values.
    *(_at_an_end,) * 4,
    # Equal values in another memory layout.
    lambda array, _: np.asfortranarray(array),
    lambda array, _: np.repeat(array, 2, axis=0)[::2],
    lambda array, _: np.flip(np.flip(array, 0).copy(), 0),
)
"""Functions that return a replacement for an array."""


def garbled(draft, rng):
    """Return the sequence of a draft with one or two fields replaced."""
    sequence = draft.made()
    changes = {}
    for _ in range(rng.choice((1, 1, 2))):
        name = rng.choice(
            ("period_us", "intensity", "time_ns", "current_ua", "width_us", "discharge_us", "site",
             "vibration", "recharge_us", "recharge_ua")
        )  # fmt: skip
        if name in ("period_us", "intensity", "time_ns", "recharge_us"):
            changes[name] = rng.choice(NUMBERS)
            continue
        array = getattr(sequence, name)
        if array is None:
            kind = np.float32 if name == "vibration" else np.int16
            array = np.zeros(sequence.current_ua.shape[1], kind)
        changes[name] = rng.choice(CHANGES)(array, rng)
    return draft.made(**changes)
