"""Frames that are prepared already are not thresholded; others are."""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.imaging.array_window import profile_for_reading
from smarttouch.imaging.tactile_mapper import TactileMapper, Tone
from smarttouch.sources.source_contract import Frame, Pose


def mapped(profile, image, tone=None):
    mapper = TactileMapper(profile, tone=tone)
    return mapper.map(Frame(image, 0, Pose(0, 0), 1.0), Mode.RA).activation[Afferent.RA]


@pytest.fixture
def shades(profile):
    """Columns of cells whose ink grows from none to all."""
    profile = profile_for_reading(profile)
    cell = np.repeat(np.linspace(255, 0, 8).round().astype(np.uint8), 8)
    return profile, np.tile(cell, (64, 1))


def test_graded_is_the_ink_itself(shades):
    profile, image = shades
    found = mapped(profile, image, Tone(0, 1, prepared=True)).reshape(8, 8)
    np.testing.assert_allclose(found, np.tile(np.linspace(0, 1, 8), (8, 1)), atol=0.003)


def test_exactly_the_part_asked_for_is_enough(profile):
    profile = profile_for_reading(profile)
    image = np.full((64, 64), 255, np.uint8)
    image[:, ::2] = 0
    assert (mapped(profile, image, Tone(0.5, 0.5, prepared=True)) == 1).all()
    assert (mapped(profile, image, Tone(0.51, 0.51, prepared=True)) == 0).all()


def test_faint_ink_counts_only_where_frames_are_prepared(profile):
    """A sensor's image of this little contrast is blank paper."""
    profile = profile_for_reading(profile)
    image = np.full((64, 64), 255, np.uint8)
    image[:, :32] = 230
    assert not mapped(profile, image).any()
    assert mapped(profile, image, Tone(0, 1, prepared=True)).any()
