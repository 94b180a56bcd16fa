"""Checks of errors by their attributes and numbers, of the numbers of a note, and of arrays."""

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
    """Expect an error of a type whose attributes have these values; see `assert_says`.

    Yields what `pytest.raises` does.
    """
    with pytest.raises(kind) as caught:
        yield caught
    assert_says(caught.value, **attributes)


def assert_says(error, value=None, allowed=None, names=None, **attributes):
    """Check that an error's attributes have these values, and that its message is one line.

    ``value`` and ``allowed`` are attributes of a SafetyError; of others the message shows them, and
    ``names``.
    What can be called judges an attribute, or one of the numbers shown, and a `pytest.approx`
    compares as it does.
    """
    message = str(error)
    assert message
    assert "\n" not in message
    shown = {"value": value, "allowed": allowed}
    shown = {name: each for name, each in shown.items() if each is not None}
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
    assert not wrong, f"{wrong} where {attributes} was expected: {message}"
    hidden = {name: each for name, each in shown.items() if not _shows(message, each)}
    assert not hidden, f"{hidden} is not shown: {message}"


def _shows(message, expected):
    """Whether a message shows a name or number, or all of several; a share as a percentage, too."""
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
    """Return the numbers of a text, in their order; those in words, as in x2, do not count."""
    return [float(each) for each in re.findall(r"(?<![\w.])-?\d+(?:\.\d+)?", text)]


def assert_close(found, expected, rel=1e-6, abs=1e-12):
    """Assert what ``found == pytest.approx(expected)`` does, of all values of arrays at once."""
    assert found.shape == expected.shape
    assert_allclose(found, expected, rtol=rel, atol=abs, equal_nan=False)
