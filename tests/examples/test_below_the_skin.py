"""What conducts below the dermis decides which polarity fires first: the study in short."""

import re

import pytest
from studies import below_the_skin
from studies.below_the_skin import first_ma, with_below

from smarttouch.physiology.finger import Finger

from ..whole import WHOLE


def test_with_fat_alone_below_cathodes_fire_first(profile):
    def ratio(conductivity: float) -> float:
        finger = Finger(profile, 1, with_below("paper", conductivity))
        return first_ma(finger, True) / first_ma(finger, False)

    assert ratio(0.022) < 1 < 1.3 < ratio(0.2)


@pytest.mark.skipif(not WHOLE, reason="long: with SMARTTOUCH_WHOLE=1, as in .ci/run")
def test_the_table_has_letters_of_both_anatomies(monkeypatch, capsys):
    monkeypatch.setattr(below_the_skin, "BELOW_S_PER_M", ())
    below_the_skin.main(1)
    _, *lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["paper", "branched"]
    # A half space keeps the ratio of macaques, and a finger alone has no spread.
    middle, low, high = map(float, re.findall(r"[\d.]+", lines[0].partition("half space")[2])[:3])
    assert 1.25 < middle < 1.4
    assert low == middle == high
