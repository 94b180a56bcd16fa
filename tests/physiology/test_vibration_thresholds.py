"""Vibration thresholds agree with published best frequencies, bands, slopes and levels."""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.physiology.vibration_thresholds import best_hz, sensitivity, threshold_um

FREQUENCIES_HZ = np.geomspace(0.1, 2000, 4001)


def db(ratio):
    return 20 * np.log10(ratio)


@pytest.mark.parametrize(("afferent", "best"), [(Afferent.RA, 30), (Afferent.PC, 250)])
def test_each_vibration_class_is_best_where_the_paper_has_it(afferent, best):
    found = FREQUENCIES_HZ[threshold_um(afferent, FREQUENCIES_HZ).argmin()]
    assert found == pytest.approx(best, rel=0.005)
    assert best_hz(afferent) == best
    assert sensitivity(afferent, best) == 1


def test_bands_are_those_of_the_paper():
    np.testing.assert_allclose(db(sensitivity(Afferent.RA, [20, 70])), -3)
    low, high = threshold_um(Afferent.PC, [60, 800])
    assert low == pytest.approx(high)
    assert threshold_um(Afferent.RA, 38) < threshold_um(Afferent.PC, 38)
    assert threshold_um(Afferent.PC, 42) < threshold_um(Afferent.RA, 42)


def test_who_answers_first_goes_from_sai_over_ra_to_pc():
    thresholds = np.array([threshold_um(each, FREQUENCIES_HZ) for each in Afferent])
    first = thresholds.argmin(axis=0)
    order = [int(first[0]), *first[1:][np.diff(first) != 0].tolist()]
    assert order == [Afferent.SAI, Afferent.RA, Afferent.PC]
    meeting = FREQUENCIES_HZ[1:][np.diff(first) != 0]
    assert 1 < meeting[0] < 8
    assert meeting[1] == pytest.approx(40, rel=0.01)  # fingertip, Güçlü and Bolanowski


def test_slopes_far_from_the_best_frequency_are_those_of_the_four_channel_model():
    def per_octave(afferent, frequency):
        return db(threshold_um(afferent, frequency) / threshold_um(afferent, frequency / 2))

    assert per_octave(Afferent.PC, 30) == pytest.approx(-12, abs=0.3)
    assert per_octave(Afferent.RA, 10) == pytest.approx(-5, abs=1.5)
    assert per_octave(Afferent.SAI, 0.5) == pytest.approx(0, abs=0.1)


def test_levels_are_those_of_the_sources():
    assert db(threshold_um(Afferent.PC, 250)) == pytest.approx(-10)
    assert db(threshold_um(Afferent.SAI, 0)) == pytest.approx(28)
    # At 40 Hz, RA's threshold equals PC's: several micrometers. At 30 Hz, RA's is similar.
    assert 5 < threshold_um(Afferent.RA, 30) < 8
