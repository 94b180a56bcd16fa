"""Dots get their names: in any standard's cells, turned, leaning, among dirt."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.braille.comb import COLUMNS, ROWS, fit_comb
from smarttouch.braille.lattice import BY_CHANCE, NEAR, cell_lines, grow_lattice, nearest_only
from smarttouch.braille.seed import find_seed

STANDARDS_MM = {
    "NLS 800": (2.34, 6.2, 10.0),
    "Marburg medium": (2.5, 6.0, 10.0),
    "Japan": (2.2, 5.9, 11.0),
    "signs in California": (2.5, 7.6, 10.2),
    "large": (2.7, 7.0, 11.0),
    "small": (2.2, 5.9, 9.5),
}
PITCH_PX = 12.0


def random_names(seed, lines=8, columns=14, density=0.4):
    """Column, line, column and row of the dot: (N, 4)."""
    rng = np.random.default_rng(seed)
    line, column, x, y = np.nonzero(rng.random((lines, columns, 2, 3)) < density)
    return np.column_stack([column, line, x, y])


def places(names, standard="NLS 800", skew_deg=0.0, lean=0.0):
    dot_mm, cell_mm, line_mm = STANDARDS_MM[standard]
    x = (names[:, 0] * cell_mm + names[:, 2] * dot_mm) / dot_mm * PITCH_PX
    y = (names[:, 1] * line_mm + names[:, 3] * dot_mm) / dot_mm * PITCH_PX
    x, y = x - x.mean(), y - y.mean()
    turn = np.radians(skew_deg)
    x, y = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    away = 1 + lean * (x + 2 * y) / (np.ptp(x) + 2 * np.ptp(y))
    return np.column_stack([x / away, y / away]) + 500


def fit(px):
    return grow_lattice(px, find_seed(px, 0.17 * PITCH_PX))


def same(names, expected):
    """Return whether names agree, but for where counting of cells begins."""
    shift = names[:, :2] - expected[:, :2]
    return (names[:, 2:] == expected[:, 2:]).all() and np.ptp(shift, axis=0).max() == 0


@pytest.mark.parametrize("standard", STANDARDS_MM)
@pytest.mark.parametrize(("skew_deg", "lean"), [(0, 0), (12, 0), (-25, 0), (4, 0.15)])
def test_every_standard(standard, skew_deg, lean):
    expected = random_names(1)
    lattice = fit(places(expected, standard, skew_deg, lean))
    names, away = lattice.name(places(expected, standard, skew_deg, lean))
    assert same(names, expected)
    assert away.max() < 0.1
    assert lattice.is_regular()
    dot_mm, cell_mm, line_mm = STANDARDS_MM[standard]
    assert lattice.dot_part == pytest.approx([dot_mm / cell_mm, dot_mm / line_mm], rel=0.03)
    if not lean:
        assert lattice.pitch_px() == pytest.approx(PITCH_PX, rel=0.02)
        right = lattice.steps()[0]
        assert np.degrees(np.arctan2(-right[1], right[0])) == pytest.approx(skew_deg, abs=0.3)


@pytest.mark.parametrize("seed", range(5))
def test_dirt_and_lost_dots(seed):
    """A third of all dots are dirt, a third of the true ones are lost, all are a bit off."""
    rng = np.random.default_rng(seed)
    expected = random_names(seed)
    true_px = places(expected, skew_deg=5, lean=0.08)
    kept = rng.random(len(true_px)) > 1 / 3
    low, high = true_px.min(axis=0), true_px.max(axis=0)
    dirt = rng.uniform(low, high, (kept.sum() // 2, 2))
    seen = true_px[kept] + rng.normal(0, 0.05 * PITCH_PX, (kept.sum(), 2))
    lattice = fit(np.vstack([seen, dirt]))
    names, away = lattice.name(true_px)
    assert same(names, expected)
    assert away.max() < NEAR


def test_dots_at_random_fit_as_often_as_said():
    rng = np.random.default_rng(1)
    lattice = fit(places(random_names(2)))
    _, away = lattice.name(rng.uniform(300, 700, (20_000, 2)))
    assert (away < NEAR).mean() == pytest.approx(BY_CHANCE, abs=0.01)


def test_seeds_gain_on_cells_only():
    rng = np.random.default_rng(3)
    px = places(random_names(3))
    assert find_seed(px, 0.17 * PITCH_PX).gain > 2.5
    anywhere = rng.uniform(px.min(axis=0), px.max(axis=0), px.shape)
    assert find_seed(anywhere, 0.17 * PITCH_PX).gain < 0


def test_where_a_page_leaves_it_open_the_first_rows_and_columns_are_used():
    """Letters a to j have no dot below."""
    expected = random_names(4)
    upper = expected[expected[:, 3] < 2]
    names, _ = fit(places(upper)).name(places(upper))
    assert same(names, upper)
    right = expected[expected[:, 2] == 1]
    names, _ = fit(places(right)).name(places(right))
    assert set(names[:, 2]) == {0}


@pytest.mark.parametrize(("teeth", "period"), [(COLUMNS, 2.5), (ROWS, 4.3)])
def test_a_comb_on_few_teeth(teeth, period):
    count = len(teeth.share)
    place = np.array(
        [10 * (group * period + tooth) for group in range(4) for tooth in range(count)]
    )
    comb = fit_comb(place + 3.0, 10.2, teeth)
    assert comb.pitch == pytest.approx(10, rel=0.06)
    assert comb.period == pytest.approx(10 * period, rel=0.02)
    off = (comb.first - 3.0 + comb.period / 2) % comb.period - comb.period / 2
    assert abs(off) < 1
    assert comb.gain > len(place)


def test_a_folded_map_is_not_regular():
    lattice = fit(places(random_names(5)))
    squeezed = lattice.weights.copy()
    squeezed[1:3, 1] = squeezed[1:3, 0]
    assert not type(lattice)(
        lattice.center_px, lattice.scale_px, squeezed, lattice.dot_part
    ).is_regular()


def test_the_nearest_has_the_name():
    names = np.array([[0, 0, 1, 2], [0, 0, 1, 2], [-3, 1, 0, 0]])
    assert nearest_only(names, np.array([0.2, 0.1, 0.3])).tolist() == [False, True, True]


lines_of_cells = st.lists(st.text(st.characters(min_codepoint=0x2800, max_codepoint=0x283F)))


@given(lines_of_cells)
def test_names_make_the_cells_they_came_from(lines):
    names = [
        (column, row, dot // 3, dot % 3)
        for row, line in enumerate(lines)
        for column, cell in enumerate(line)
        for dot in range(6)
        if (ord(cell) - 0x2800) >> dot & 1
    ]
    stripped = [line.rstrip("\u2800") for line in lines]
    while stripped and not stripped[-1]:
        stripped.pop()
    while stripped and not stripped[0]:
        stripped.pop(0)
    indent = min((len(line) - len(line.lstrip("\u2800")) for line in stripped if line), default=0)
    assert cell_lines(np.array(names, int).reshape(-1, 4)) == [line[indent:] for line in stripped]
