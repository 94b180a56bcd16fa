"""Assertions about errors and their messages, about numbers in texts, and about arrays."""

import math
import numbers
import re
from collections.abc import Iterable
from contextlib import contextmanager
from enum import Enum

import pytest
from numpy.testing import assert_allclose

from smarttouch.base.errors import SafetyError

_NUMBER = r"-?\d[\d,]*\.?\d*(?:e[+-]?\d+)?"


@contextmanager
def raises(kind, **attributes):
    """Expect an error of type ``kind``. Check it with `assert_says`, given ``attributes``.

    Yields the exception info of `pytest.raises`.
    """
    with pytest.raises(kind) as caught:
        yield caught
    assert_says(caught.value, **attributes)


def assert_says(error, value=None, allowed=None, names=None, **attributes):
    """Assert that an error has these attributes, and that its message is a single line.

    A SafetyError must have ``value`` and ``allowed`` as attributes; any other error must state them
    in its message. Each message must contain ``names``. An expected value can be a `pytest.approx`
    or a predicate. A predicate must accept the attribute or a number in the message.
    """
    message = str(error)
    assert message
    assert "\n" not in message
    shown = {"value": value, "allowed": allowed}
    shown = {name: expected for name, expected in shown.items() if expected is not None}
    if isinstance(error, SafetyError):
        attributes, shown = attributes | shown, {}
    if names is not None:
        shown["names"] = names
    found = {name: getattr(error, name) for name in attributes}
    wrong = {
        name: found[name]
        for name, expected in attributes.items()
        if not (expected(found[name]) if callable(expected) else found[name] == expected)
    }
    assert not wrong, f"{wrong} is not the expected {attributes}: {message}"
    missing = {name: part for name, part in shown.items() if not _shows(message, part)}
    assert not missing, f"{missing} is missing in the message: {message}"


def _shows(message, expected):
    """Return whether a message states a name, a number (also in % or millions), or a whole list."""
    expected = getattr(expected, "expected", expected)
    found = [float(each.replace(",", "")) for each in re.findall(_NUMBER, message)]
    if callable(expected):
        return any(map(expected, found))
    if isinstance(expected, Enum) and not isinstance(expected, str):
        return expected.name in message
    if isinstance(expected, str) or not isinstance(expected, Iterable | numbers.Real):
        return str(expected).strip() in message
    if isinstance(expected, Iterable):
        return all(_shows(message, each) for each in expected)
    if not math.isfinite(expected):
        return str(float(expected)) in message
    scales = (
        (1, 100) if "%" in message else (1, 1e-6) if "mega" in message or "MB" in message else (1,)
    )
    return any(
        math.isclose(each, scale * expected, rel_tol=0.02, abs_tol=1e-9)
        for each in found
        for scale in scales
    )


def numbers_in(text):
    """Return the numbers in a text in order, without digits inside words, as in x2."""
    return [float(each) for each in re.findall(r"(?<![\w.])-?\d+(?:\.\d+)?", text)]


def assert_close(found, expected, rel=1e-6, abs=1e-12):
    """Assert that two arrays have the same shape and, within tolerances, the same values."""
    assert found.shape == expected.shape
    assert_allclose(found, expected, rtol=rel, atol=abs, equal_nan=False)
