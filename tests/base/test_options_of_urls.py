"""Options in the URLs of sources and boards."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from smarttouch.base.errors import BoardError, SourceError
from smarttouch.base.urls import read_options

from ..support.checks import raises


def opener(
    rest: str,
    *,
    size: tuple[int, int] | None = None,
    fps: float | None = None,
    seed: int = 0,
    path: Path | None = None,
    unpaced: bool = False,
    events: Sequence[str] = (),
    light_on_dark: bool = False,
    other: np.ndarray | None = None,
):
    """Take options of every type."""


@pytest.mark.parametrize(("url", "rest", "options"), [
    ("0?size=640x480&fps=12.5", "0", {"size": (640, 480), "fps": 12.5}),
    ("a?seed=3&path=b%20c.csv", "a", {"seed": 3, "path": Path("b c.csv")}),
    ("a?unpaced", "a", {"unpaced": True}),
    ("a?unpaced=0", "a", {"unpaced": False}),
    ("?events=1 lift&events=2 press", "", {"events": ["1 lift", "2 press"]}),
    ("a?b?seed=1", "a?b", {"seed": 1}),
])  # fmt: skip
def test_options_in_their_types(url, rest, options):
    assert read_options(opener, url, SourceError) == (rest, options)


@pytest.mark.parametrize("url", ["", "a", "Why?", "Is it so? Yes", "a?b.png", "a?", "a?Seed=1"])
def test_a_question_mark_need_not_begin_options(url):
    assert read_options(opener, url, SourceError) == (url, {})


def test_an_opener_without_options_reads_its_own():
    url = "/dev/ttyUSB0?slow&firmware=newest"
    assert read_options(lambda rest, limits: None, url, BoardError) == (url, {})


@pytest.mark.parametrize(("url", "about", "value"), [
    ("a?speed=1", "?speed", "speed"),
    ("a?other=1", "?other", "other"),
    ("a?light_on_dark=1", "?light_on_dark", "light_on_dark"),
    ("a?seed=x", "?seed", "x"),
    ("a?seed=1.5", "?seed", "1.5"),
    ("a?fps=", "?fps", ""),
    ("a?unpaced=maybe", "?unpaced", "maybe"),
    *((f"a?size={text}", "?size", text) for text in ("640", "640x", "0x5", "6_4x4", "1x2x3")),
    ("a?seed=1&seed=2", "?seed", None),
])  # fmt: skip
def test_options_that_are_none(url, about, value):
    with raises(SourceError, names=about, value=value):
        read_options(opener, url, SourceError, but=("light_on_dark",))
    if value == "speed":
        offered = "events, fps, light_on_dark, path, seed, size, unpaced"
        with raises(SourceError, names=about, allowed=offered):
            read_options(opener, url, SourceError)
