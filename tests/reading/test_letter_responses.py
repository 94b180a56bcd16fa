"""Letters on fingers: full strength, read where they are clear, the same from the same seed."""

import pytest

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.reading import letter_responses


@pytest.fixture(scope="module")
def small():
    profile = load_profile("smarttouch-4x4")
    return profile, load_bank(profile)


def test_a_letter_is_given_at_full_comfort(small):
    profile, bank = small
    sequence, active = letter_responses.letter_sequence("L", profile, bank, Mode.RA)
    assert sequence.intensity == 1
    assert active.any()
    assert abs(sequence.current_ua).max() == pytest.approx(1000 * profile.full_ma.max(), rel=0.01)


def test_the_same_fingers_respond_the_same(small):
    profile, bank = small
    one, again = (
        letter_responses.respond_to_letters(profile, bank, Mode.RA, "paper", (1, 2), "LT")
        for _ in range(2)
    )
    assert one == again
    assert [(each.letter, each.seed) for each in one] == [("L", 1), ("T", 1), ("L", 2), ("T", 2)]
    figures = letter_responses.summary(one)
    assert set(figures) == {
        "silent_points", "wrong_class", "misplaced", "median", "worst_tenth",
    }  # fmt: skip


def test_ra_mode_fires_mostly_ra_in_the_paper_s_anatomy(small):
    profile, bank = small
    found = letter_responses.respond_to_letters(profile, bank, Mode.RA, "paper", (1, 2, 3), "T")
    assert sum(each.quality.afferents[Afferent.RA] for each in found) > 0
    assert letter_responses.summary(found)["wrong_class"] < 0.5


def test_letters_are_distinguished_at_the_board_of_many_electrodes(profile, bank):
    assert letter_responses.error_at_board(profile, bank, Mode.RA, "LTO") == 0
