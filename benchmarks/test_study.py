"""Time to simulate one finger of a study."""

import pytest

from smarttouch.experiments.simulated_study import Study, rows_of_letters, study_letters
from smarttouch.physiology.afferent_anatomy import load_anatomy
from smarttouch.profile import load_profile


@pytest.mark.parametrize("anatomy", ["paper", "branched"])
def test_a_finger_with_26_letters_and_two_scans(benchmark, quick, anatomy):
    letters = "LT" if quick else Study(title="all").letters
    study = Study(title="scans", scans=("points", "auto"), letters=letters)
    (name,) = study.profiles
    profile = load_profile(name)
    shown = study_letters(study, name, profile)
    rows = benchmark(rows_of_letters, profile, shown, load_anatomy(anatomy), anatomy, 1)
    assert len(rows) == 2 * len(letters)
