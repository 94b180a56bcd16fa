"""Arrays that are equal but for rounding."""

from numpy.testing import assert_allclose


def assert_close(found, expected, rel=1e-6, abs=1e-12):
    """Assert what ``found == pytest.approx(expected)`` does, of all values of arrays at once."""
    assert found.shape == expected.shape
    assert_allclose(found, expected, rtol=rel, atol=abs, equal_nan=False)
