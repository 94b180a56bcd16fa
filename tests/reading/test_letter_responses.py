"""Letters on fingers: full strength, the same from the same seed."""

import pytest

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.kernels.bank import load_bank
from smarttouch.physiology.finger import Finger
from smarttouch.profile import load_profile
from smarttouch.reading.letter_responses import (
    letter_sequences,
    letter_templates,
    letters_on_finger,
)


@pytest.fixture(scope="module")
def shown():
    """A profile, and its letters L and T in RA mode."""
    profile = load_profile("smarttouch-4x4")
    return profile, letter_sequences("LT", profile, load_bank(profile), Mode.RA)


def respond(shown, seed):
    profile, letters = shown
    finger = Finger(profile, seed, "paper")
    return letters_on_finger(finger, letters, Mode.RA.afferents, letter_templates(profile))


def test_a_letter_is_given_at_full_comfort(shown):
    profile, letters = shown
    for sequence, active in letters.values():
        assert sequence.intensity == 1
        assert active.any()
        full_ua = 1000 * profile.full_ma.max()
        assert abs(sequence.current_ua).max() == pytest.approx(full_ua, rel=0.01)


def test_the_same_fingers_respond_the_same(shown):
    one, again = respond(shown, 1), respond(shown, 1)
    assert one == again
    assert one != respond(shown, 2)
    assert [(each.letter, each.seed) for each in one] == [("L", 1), ("T", 1)]


def test_ra_mode_fires_mostly_ra_in_the_paper_s_anatomy(shown):
    found = [each.quality for seed in (1, 2, 3) for each in respond(shown, seed)]
    assert sum(each.afferents[Afferent.RA] for each in found) > 0
    assert sum(each.wrong_class for each in found) / len(found) < 0.5
