"""Sources and boards by URL, including those of other packages, and options in URLs."""

from collections.abc import Sequence
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest

from smarttouch.base.clock import MonotonicClock
from smarttouch.base.errors import BoardClosedError, BoardError, SourceError
from smarttouch.base.urls import read_options
from smarttouch.boards.open import (
    BOARDS,
    default_profile,
    make_board,
    may_touch_a_finger,
)
from smarttouch.emulator.drivers import MemoryDriver
from smarttouch.profile import DEFAULT_PROFILE
from smarttouch.sources import open_source
from smarttouch.sources.force import open_force
from smarttouch.stimulation.safety_gate import SafetyLimits

from ..support.checks import raises
from ..support.plugin_packages import install

BOARD = """
from smarttouch.boards.driver import Driver
from smarttouch.boards.reports import Capabilities

class Mine(Driver):
    def __init__(self, rest, limits, output=None): ...
    def open(self, line, limits):
        return Capabilities(limits.electrodes, "weighted", limits.current_ma, 100, 0.0, "mine")
    def write(self, proved): ...
    def zero(self): ...
"""
SOURCE = """
from smarttouch.sources.source_contract import OpticalSource

class Mine(OpticalSource):
    def __init__(self, rest, profile):
        super().__init__("mine")

    def read(self, time_ns):
        return None

def open_mine(rest, profile, *, shade=0):
    return Mine(rest, profile)

def open_nothing(rest, profile):
    return object()
"""


@pytest.fixture
def limits(profile):
    return SafetyLimits.of(profile)


@pytest.fixture
def installed(tmp_path, monkeypatch, request):
    """Return a function that installs a package with one entry point, named `mine` by default."""
    monkeypatch.syspath_prepend(tmp_path)

    def put(text, group="smarttouch.boards", target="Mine", package="their-board", name="mine"):
        # Imported modules stay loaded, so each test needs a module of its own.
        module = f"{package}_{abs(hash(request.node.name))}".replace("-", "_")
        install(tmp_path, package, {group: {name: f"{module}:{target}"}}, {module: text})

    return put


def test_a_board_of_others(installed, limits):
    installed(BOARD)
    board = make_board("mine:anything", limits)
    with board:
        assert board.capabilities.firmware == "mine"
    assert may_touch_a_finger("mine:")
    assert default_profile("mine:") == DEFAULT_PROFILE
    assert "mine" in BOARDS.names


def test_a_source_of_others(installed, profile):
    installed(SOURCE, "smarttouch.sources", "open_mine")
    with open_source("mine:", profile, shade=3) as source:
        assert source.read(0) is None
    with raises(SourceError, names="color", allowed=("shade",)):
        open_source("mine:", profile, color=1)


def test_no_other_package_takes_a_name_of_ours(installed, limits):
    installed(BOARD, name="memory")
    assert entry_points(group="smarttouch.boards", name="memory")
    assert type(make_board("memory:", limits).driver) is MemoryDriver
    assert BOARDS.names.count("memory") == 1


@pytest.mark.parametrize(("text", "value"), [
    ("import nothing_of_that_name\n" + BOARD, ("their-board", "nothing_of_that_name")),
    ("Theirs = 1\n", ("their-board", "Mine")),
    ("class Mine:\n    def __init__(self, *given): ...\n", ("mine:", "Driver")),
])  # fmt: skip
def test_what_is_no_board_is_refused_by_its_package(installed, limits, text, value):
    installed(text)
    with raises(BoardError, value=value):
        make_board("mine:", limits)
    installed(BOARD, package="another")
    with raises(BoardError, names="board", value="mine", allowed=("another", "their-board")):
        make_board("mine:", limits)


@pytest.mark.parametrize("group", ["sources", "forces"])
def test_what_is_no_source_is_refused(installed, profile, group):
    installed(SOURCE, f"smarttouch.{group}", "open_nothing", "their-source")
    opener = open_source if group == "sources" else open_force
    with raises(SourceError, value="mine:"):
        opener("mine:", profile)


def test_a_board_of_others_may_have_a_finger_on_it(installed, limits):
    """A driver's attributes cannot exempt its board from the rules for boards on a finger."""
    installed(BOARD + "    on_a_finger, simulated_time, claimed_time = False, True, True\n")
    board = make_board("mine:", limits)
    assert (board.on_a_finger, board.simulated_time, board.announced) == (True, False, True)
    assert may_touch_a_finger("mine:")
    assert type(board.clock) is MonotonicClock


def test_a_driver_without_capabilities(installed, limits):
    installed(BOARD.replace("return Capabilities", "Capabilities"))
    board = make_board("mine:", limits)
    with raises(BoardError, names="Capabilities", value="Mine"):
        board.open()
    with raises(BoardClosedError, names="board"):
        board.send(None)


@pytest.mark.parametrize(("url", "meant"), [
    ("emulator", "emulator:"), ("emulaator:", "emulator:"), ("lnk:/dev/x", "link:"),
    ("/dev/ttyUSB0", "link:"), ("zzz:", "link:"),
])  # fmt: skip
def test_what_was_meant(url, meant):
    with raises(BoardError, names=meant):
        BOARDS.find(url)


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
