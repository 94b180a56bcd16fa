"""Checks that numbers lie within ranges."""

import math
from contextlib import nullcontext

import pytest

from smarttouch.base.errors import SourceError, require_within

from ..support.checks import raises


@pytest.mark.parametrize(("value", "lowest", "highest", "above", "within"), [
    *((value, 1, 4, False, True) for value in (1, 2.5, 4)),
    *((value, 1, 4, False, False) for value in (0.999, 4.001, -math.inf, math.inf)),
    (math.nan, -math.inf, math.inf, False, False),
    # With ``above``, the lower end does not belong to the range.
    (1e-9, 0, 1, True, True),
    (0, 0, 1, True, False),
])  # fmt: skip
def test_numbers_and_ranges(value, lowest, highest, above, within):
    ends = (lowest, highest)
    with nullcontext() if within else raises(SourceError, names="hz", value=value, allowed=ends):
        require_within(SourceError, "hz", value, lowest, highest, above=above)
