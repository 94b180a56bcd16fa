"""Steps, kernels and banks of kernels are pictures in notebooks, of what they hold."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.array_picture import cells_svg

SVG = "{http://www.w3.org/2000/svg}"


def cells(svg):
    """Return each colored cell as column, row, color and strength."""
    found = ElementTree.fromstring(svg).iter(f"{SVG}rect")
    return [
        (int(each.get("x")) // 8, int(each.get("y")) // 8, each.get("fill"),
         float(each.get("fill-opacity")))
        for each in found if each.get("fill") != "none"
    ]  # fmt: skip


def test_cells_are_where_and_what_the_values_are():
    orange, purple = "#b35806", "#542788"
    drawn = cells(cells_svg(np.array([[0, 2.0, np.nan], [-1.0, 0, 0]])))
    assert drawn == [(1, 0, orange, 1.0), (0, 1, purple, 0.5)]


@pytest.mark.parametrize("values", [np.zeros((2, 3)), np.zeros((0, 3)), np.zeros(4)])
def test_nothing_is_an_empty_frame(values):
    assert cells(cells_svg(values)) == []


def test_large_arrays_are_cut():
    assert len(cells(cells_svg(np.ones((5000, 64))))) <= 20_000


def test_what_a_notebook_shows():
    profile = st.load_profile("electric-mouse")
    step = max(
        st.steps(st.open_source("text:a", profile, speed_mm_s=60), profile, seconds=1.2),
        key=lambda each: each.sequence.slots,
    )
    shown = ElementTree.fromstring(step._repr_html_())
    activation, currents = shown.iter(f"{SVG}svg")
    colored = [each for each in currents.iter(f"{SVG}rect") if each.get("fill") != "none"]
    assert len(colored) == np.count_nonzero(step.sequence.current_ua)
    assert [each.text for each in activation.iter(f"{SVG}text")] == ["RA", "SAI", "PC"]
    line = st.load_profile("line-7")
    for other, least in ((st.load_kernels(profile), 64), (st.design_kernel(line, "RA", 3), 7)):
        assert len(cells(f"<div>{other._repr_html_()}</div>")) >= least
