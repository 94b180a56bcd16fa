"""Field maps: the same as all rows, on grids and on arrays that are none."""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.frame_fields import FieldMap
from smarttouch.physiology.activating_function import af_matrix, everywhere
from smarttouch.profile import load_profile

from ..whole import sample


def random_currents(profile, count=5, seed=0):
    current = np.random.default_rng(seed).normal(size=(count, len(profile.electrodes)))
    return current - current.mean(axis=1, keepdims=True)


@pytest.mark.parametrize("afferent", sample(Afferent))
@pytest.mark.parametrize(("name", "separable", "spacing_mm"), [
    ("electric-mouse", True, 0.25), ("smarttouch-4x4", True, 0.1), ("optacon-24x6", True, 0.5),
    ("kajimoto-61", False, 0.25), ("line-7", False, 0.1),
])  # fmt: skip
def test_a_map_is_what_all_rows_are(changed, name, separable, spacing_mm, afferent):
    profile = changed(load_profile(name), {"skin.node_spacing_mm": spacing_mm})
    nodes = everywhere(profile, afferent)
    field, rows = FieldMap(profile, nodes), af_matrix(profile, nodes)
    assert field.separable is separable
    current = random_currents(profile)
    # Fields of a frame are known to 0.2 % of their largest: far below any bound's meaning.
    whole = current @ rows.T
    assert np.abs(field(current) - whole).max() < 2e-3 * np.abs(whole).max()
    gram = rows.T @ rows
    assert np.abs(field.gram() - gram).max() < 1e-3 * np.abs(gram).max()


def test_electrodes_in_another_order_are_where_they_are(profile, changed):
    few = {"array.rows": 4, "array.columns": 5, "skin.node_spacing_mm": 0.25}
    profile = changed(profile, few)
    order = np.random.default_rng(2).permutation(20)
    places = profile.electrodes.position_mm[order]
    array = {"layout": "free", "positions_mm": places.tolist(), "size_mm": [1.0, 0.0]}
    shuffled = changed(profile, {"array": array})
    nodes = everywhere(profile, Afferent.SAI)
    there = FieldMap(shuffled, nodes)
    assert there.separable
    current = random_currents(profile)
    here = FieldMap(profile, nodes)(current)
    assert there(current[:, order]) == pytest.approx(here, abs=float(1e-3 * np.abs(here).max()))
