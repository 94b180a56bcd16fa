"""Operators of frames, made once for a file."""

import pytest

from smarttouch.kernels.frame_judges import FrameJudge, full_wish
from smarttouch.kernels.frame_operator import FrameOperator


@pytest.fixture(scope="module")
def make_operator(profile, bank, changed):
    """Return a maker of operators with places as far apart as where frames are shown."""
    made, profile = {}, changed(profile, {"skin.node_spacing_mm": 0.5})

    def make(afferent):
        if afferent not in made:
            wish = full_wish(profile, bank.kernels(afferent), bank.receptor[afferent])
            made[afferent] = FrameOperator(FrameJudge(profile, afferent, wish))
        return made[afferent]

    return make
