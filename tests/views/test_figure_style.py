"""Figures are refused before any work is done, not after it."""

import sys
from pathlib import Path

import pytest

from smarttouch.base.errors import SmartTouchError
from smarttouch.views.figure_style import require_drawable

from ..raising import raises


@pytest.mark.parametrize("name", ["figure", "figure.gif", "figure.png.txt"])
def test_a_name_of_no_kind_of_figure(name):
    allowed = (".png", ".pdf", ".svg")
    with raises(SmartTouchError, value=Path(name), allowed=allowed):
        require_drawable(Path(name))


def test_without_matplotlib(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    remedy = "pip install 'smarttouch[plot]'"
    with raises(SmartTouchError, names=remedy):
        require_drawable(Path("figure.svg"))
