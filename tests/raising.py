"""`pytest.raises` by what an error says of itself in attributes, not by its words."""

from contextlib import contextmanager

import pytest


@contextmanager
def raises(kind, **attributes):
    """Expect an error of a type whose attributes have these values.

    Yields what `pytest.raises` does. A value that can be called judges the attribute instead,
    and a `pytest.approx` compares as it does.
    """
    with pytest.raises(kind) as caught:
        yield caught
    assert_says(caught.value, **attributes)


def assert_says(error, **attributes):
    """Check that an error's attributes have these values, and that its message is one line."""
    message = str(error)
    assert message
    assert "\n" not in message
    found = {name: getattr(error, name) for name in attributes}
    wrong = {
        name: found[name]
        for name, expected in attributes.items()
        if not (expected(found[name]) if callable(expected) else found[name] == expected)
    }
    assert not wrong, f"{wrong} where {attributes} was expected: {message}"
