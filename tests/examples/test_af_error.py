"""Errors of the AF against the cable model."""

from functools import partial

import pytest
from studies import af_error

from smarttouch.physiology.membrane import threshold_ma

# The shallowest, those of RA and SAI, and the deepest.
DEPTHS_MM = (0.5, 0.7, 0.9, 2.0)


@pytest.fixture(scope="module")
def table(profile):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(af_error, "DEPTHS_MM", DEPTHS_MM)
        # What is asked of the figures below are not their last digits.
        patch.setattr(af_error, "_NODES", 121)
        patch.setattr(af_error, "threshold_ma", partial(threshold_ma, step_us=5.0))
        rows = af_error.af_error_table(profile)
    return {(row.fiber, row.polarity, row.depth_mm): row for row in rows}


def test_one_threshold_gives_all_of_a_flat_fiber(table):
    """Within a fifth over depth and polarity, at the internodes of a fingertip."""
    for depth_mm in DEPTHS_MM:
        for polarity in ("cathodic", "anodic"):
            assert table["flat fiber", polarity, depth_mm].ratio == pytest.approx(1, abs=0.2)
    assert table["flat fiber", "cathodic", 0.9].ratio == pytest.approx(1, abs=1e-9)


def test_endings_need_more_than_by_the_af(table):
    for depth_mm in DEPTHS_MM:
        assert table["rising, passive ending", "anodic", depth_mm].ratio < 0.7
        assert table["rising, active ending", "cathodic", depth_mm].ratio < 0.5


def test_the_af_has_no_cathode_for_a_passive_ending_the_cable_has(table):
    row = table["rising, passive ending", "cathodic", 0.7]
    assert row.af_ma == float("inf")
    assert row.cable_ma < 5
    assert row.cable_ma > table["rising, passive ending", "anodic", 0.7].cable_ma
