"""What conducts below the dermis decides which polarity fires first: the study in short."""

from studies.below_the_skin import first_ma, with_below

from smarttouch.physiology.finger import Finger


def test_with_fat_alone_below_cathodes_fire_first(profile):
    def ratio(conductivity: float) -> float:
        finger = Finger(profile, 1, with_below("paper", conductivity))
        return first_ma(finger, True) / first_ma(finger, False)

    assert ratio(0.022) < 1 < 1.3 < ratio(0.2)
