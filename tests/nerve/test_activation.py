"""The AF matrix and where its nodes are."""

import numpy as np
import pytest

from smarttouch.nerve.activation import af_matrix
from smarttouch.nerve.afferents import everywhere, targets
from smarttouch.primary import Primary
from smarttouch.profile import load_profile, profile_names


@pytest.mark.parametrize("name", profile_names())
@pytest.mark.parametrize("primary", list(Primary))
def test_shape_and_sign_at_the_target(name, primary):
    profile = load_profile(name)
    matrix = af_matrix(profile, targets(profile, primary))
    count = len(profile.electrodes)
    assert matrix.shape == (count, count)
    own = np.diag(matrix)
    assert np.all(own < 0) if primary is Primary.RA else np.all(own > 0)


def test_paper_nodes_run_from_minus_five_to_five():
    sai = everywhere(load_profile("line-7"), Primary.SAI)[0]
    assert sai.position_mm[:, 0] == pytest.approx(np.arange(-5, 6))
    assert not sai.position_mm[:, 1].any()


def test_nodes_lie_in_every_direction_and_beyond_the_edge(profile):
    sets = everywhere(profile, Primary.SAI)
    assert [each.angle_deg for each in sets] == [0, 45, 90, 135]
    assert np.abs(sets[0].position_mm).max() == pytest.approx(9.0)


def test_superposition_is_linear_in_conductivity(profile):
    half = profile.model_copy(
        update={"skin": profile.skin.model_copy(update={"conductivity_s_per_m": 0.215})}
    )
    nodes = targets(profile, Primary.SAI)
    assert af_matrix(half, nodes) == pytest.approx(2 * af_matrix(profile, nodes))
