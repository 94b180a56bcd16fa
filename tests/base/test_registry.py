"""Sources and boards of other packages: found, and refused at once where they are broken."""

from dataclasses import replace
from importlib.metadata import entry_points

import pytest

from smarttouch.base.errors import BoardClosedError, BoardError, SmartTouchError, SourceError
from smarttouch.base.registry import find_opener, known_names
from smarttouch.boards.open import MemoryBoard, default_profile, make_board, may_touch_a_finger
from smarttouch.profile import DEFAULT_PROFILE
from smarttouch.running.display import open_display
from smarttouch.sources import open_source
from smarttouch.sources.force import open_force
from smarttouch.stimulation.safety_gate import SafetyLimits

from ..installed import install
from ..raising import raises

BOARD = """
from smarttouch.boards.board import Board, BoardReport, Capabilities

class Mine(Board):
    def __init__(self, rest, limits, output=None):
        super().__init__(limits, output)
        self.capabilities = Capabilities(
            limits.electrodes, "weighted", limits.current_ma, 100, 0.0, "mine"
        )

    def drain(self, timeout_s=1.0): ...
    def report(self):
        return BoardReport(0, 0, 0, 0, 0.0, 0.0, 0.0)
    def _open(self): ...
    def _send(self, sequence, times):
        return 1
    def _stop(self): ...
    def _close(self): ...
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
    """Return an installer of one module under an entry-point group; its name is `mine`."""
    monkeypatch.syspath_prepend(tmp_path)

    def put(text, group="smarttouch.boards", target="Mine", package="their-board", name="mine"):
        # Modules stay imported: each test has its own.
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
    assert "mine" in known_names("smarttouch.boards")


def test_a_source_of_others(installed, profile):
    installed(SOURCE, "smarttouch.sources", "open_mine")
    with open_source("mine:", profile, shade=3) as source:
        assert source.read(0) is None
    with raises(SourceError, names="color", allowed=("shade",)):
        open_source("mine:", profile, color=1)


def test_no_other_package_takes_a_name_of_ours(installed, limits):
    installed(BOARD, name="memory")
    assert entry_points(group="smarttouch.boards", name="memory")
    assert type(make_board("memory:", limits)) is MemoryBoard
    assert known_names("smarttouch.boards").count("memory") == 1


def test_two_packages_with_one_name(installed, limits):
    installed(BOARD)
    installed(BOARD, package="another")
    both = {"value": "mine", "allowed": ("another", "their-board")}
    with raises(BoardError, names="board", **both):
        make_board("mine:", limits)


def without(line, text=BOARD):
    assert line in text
    return text.replace(line, "")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("import nothing_of_that_name\n" + BOARD, "nothing_of_that_name"),
        ("Theirs = 1\n", "Mine"),
        # Refused where it is defined, by Board itself.
        (BOARD + "\n    def send(self, *given, **named): ...\n", "send"),
        (BOARD + "    clock = dose = None\n", "clock"),
    ],
)
def test_a_board_that_cannot_be_loaded_is_refused_by_its_package(installed, limits, text, words):
    installed(text)
    with raises(BoardError, value=("their-board", words)):
        make_board("mine:", limits)


def test_what_is_no_board_is_refused(installed, limits):
    installed("class Mine:\n    def __init__(self, *given): ...\n")
    with raises(BoardError, value=("mine:", "Board")):
        make_board("mine:", limits)


@pytest.mark.parametrize("group", ["sources", "forces"])
def test_what_is_no_source_is_refused(installed, profile, group):
    installed(SOURCE, f"smarttouch.{group}", "open_nothing", "their-source")
    opener = open_source if group == "sources" else open_force
    with raises(SourceError, value="mine:"):
        opener("mine:", profile)


@pytest.mark.parametrize(
    ("more", "about"),
    [
        ("        from dataclasses import replace; limits = replace(limits, current_ma=5.0)", ""),
        ("        self._gate = type('Open', (), {'prove': lambda *_: None})()", "gate"),
        ("        self._gate.prove = lambda sequence, times: sequence", "gate"),
        ("        self.send = print", "send"),
        ("        self._clock = type('Clock', (), {'now_ns': lambda _: 0})()", "clock"),
        ("    def _time(self): ...", "clock"),
    ],
)  # fmt: skip
def test_a_board_that_goes_around_its_gate_is_refused(installed, limits, more, about):
    head, tail = BOARD.split("        super().__init__(limits, output)\n")
    base = "        super().__init__(limits, output)\n"
    if about:
        rest, methods = tail.split("\n    def drain")
        text = head + base + rest + "\n" + more + "\n\n    def drain" + methods
    else:
        text = head + more + "\n" + base + tail
    installed(text)
    with raises(BoardError, names=about or "limits", value="Mine"):
        make_board("mine:", limits)


def test_where_no_finger_can_be_time_is_what_sequences_claim(installed, limits):
    installed(BOARD + "    on_a_finger = False\n    def _time(self): ...\n")
    assert make_board("mine:", limits)
    assert not may_touch_a_finger("mine:")


def test_a_board_without_capabilities(installed, limits):
    start, end = BOARD.index("        self.capabilities"), BOARD.index("    def drain")
    installed(BOARD[:start] + BOARD[end:])
    board = make_board("mine:", limits)
    with raises(BoardError, names="capabilities", value="Mine"):
        board.open()
    with raises(BoardClosedError, names="board"):
        board.send(None)


@pytest.mark.parametrize("name", [
    "send", "stop", "halt", "close", "open", "dose", "clock", "measure", "_refuse_late", "__exit__",
])  # fmt: skip
def test_no_board_is_defined_without_its_safety(name):
    with raises(BoardError, names=name, value="Theirs"):
        type("Theirs", (MemoryBoard,), {name: lambda self: None})


@pytest.mark.parametrize("group", ["smarttouch.sources", "smarttouch.forces", "smarttouch.boards"])
def test_ours_are_where_they_are_registered(group):
    for name in known_names(group):
        opener, rest = find_opener(group, f"{name}:rest", SmartTouchError)
        assert callable(opener)
        assert rest == "rest"


def test_a_display_of_a_class_has_the_gate_too(profile):
    class Wide(MemoryBoard):
        def __init__(self, rest, limits, output=None):
            super().__init__(rest, replace(limits, rate_hz=200.0), output)

    with raises(BoardError, names="limits", value="Wide"):
        open_display(Wide, profile)
    assert open_display(MemoryBoard, profile).board.capabilities is not None


@pytest.mark.parametrize(("url", "meant"), [
    ("emulator", "emulator:"), ("emulaator:", "emulator:"), ("lnk:/dev/x", "link:"),
    ("/dev/ttyUSB0", "link:"), ("zzz:", "link:"),
])  # fmt: skip
def test_what_was_meant(url, meant):
    with raises(BoardError, names=meant):
        find_opener("smarttouch.boards", url, BoardError)
