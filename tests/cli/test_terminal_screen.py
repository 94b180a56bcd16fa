"""Tests of the screen of a run at several sizes, and of the plain lines that replace it."""

import io
import itertools
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

import smarttouch as st
from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.events import Advice, ModeChanged, Paused, Resumed
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.loop import Controls, ControlState
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step_records import StepResult
from smarttouch.sources.source_contract import Frame, Stimulus
from smarttouch.stimulation.scan_sequence import NO_SHARING, SlotPolicy
from smarttouch.views.character_pictures import ArrayPicture, image_rows
from smarttouch.views.terminal_screen import Screen, summary_lines

SIZES = [(120, 40), (80, 24), (60, 15)]
MARKS = "·○◔◑◕●"


def printed(paper=255, ink=0):
    image = np.full((64, 64), paper, np.uint8)
    image[20:44, 20:44] = ink
    return image


@pytest.fixture(scope="module", params=[NO_SHARING, SlotPolicy((Afferent.RA,))])
def sent(request, profile, bank):
    pipeline = Pipeline(profile, bank, RunConfig(scan=request.param))
    for time_ns in range(10**9, 2 * 10**9, 20_000_000):
        step = pipeline.process(Frame(printed(), time_ns, force_n=1.0))
    assert step.sequence.intensity == 1
    return StepResult(step, 1, 0.0)


@pytest.fixture
def shown(profile, monkeypatch):
    """Return a function that draws the screen at a given size and returns its lines."""
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))

    def lines(size, *told, color=True, keys_help=""):
        screen = Screen("emulator:", keys_help, plain=True)
        screen._console = Console(
            width=size[0], height=size[1], file=io.StringIO(), no_color=not color,
            force_terminal=True, color_system="truecolor",
        )  # fmt: skip
        screen.prepare(SimpleNamespace(
            source=SimpleNamespace(title="page.png", dropped_frames=0, frames=2, duration_s=9.0),
            profile=profile,
            controls=Controls(ControlState(Mode.RA, 0.5)),
            board=SimpleNamespace(
                dose=SimpleNamespace(seconds=1.0, most_mc=2.0, most_net_uc=3.0), acknowledged=1
            ),
            statistics=RunStatistics(),
        ))  # fmt: skip
        for each in told:
            (screen.step if isinstance(each, StepResult) else screen.event)(each)
        rendered = screen._console.render_lines(screen._render(), pad=False)
        return ["".join(part.text for part in line) for line in rendered]

    return lines


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("color", [True, False])
def test_all_that_counts_is_there_and_whole(shown, sent, size, color):
    seen = shown(size, sent, ModeChanged(10**9, Mode.SAI), color=color)
    assert len(seen) < size[1]
    assert all(len(line.rstrip()) <= size[0] for line in seen)
    top, all_of_it = "\n".join(seen[:5]), "\n".join(seen)
    for name in ("intensity", "current", "pressure", "charge"):
        assert name in top
    peak_ma, limit_ma = np.abs(sent.sequence.current_ua).max() / 1000, 5
    assert f"{peak_ma:.2f}/{limit_ma} mA" in top
    assert "0.50" in top
    for key in ("+ −", "0 ", "space", "m ", "q"):
        assert key in top
    assert str(Mode.SAI) in top
    # Each electrode is drawn as one mark.
    assert sum(all_of_it.count(mark) for mark in MARKS) == 64
    assert all_of_it.count("·") == 64 - sent.sequence.points
    if size[1] >= 24:
        for name in ("time", "rate", "latency", "session", "finger", "frames", "board"):
            assert re.search(rf"\b{name} ", all_of_it), name
        assert "…" not in all_of_it


@pytest.mark.parametrize("size", SIZES)
def test_it_does_not_jump(shown, sent, size):
    empty = replace(sent.step, input=replace(sent.step.input, image=printed(255, 255)))
    long = Advice(10**9, "a sentence that goes on " * 20)
    told = [(sent,), (StepResult(empty, 2, 0.0),), (sent, ModeChanged(0, Mode.PC)), (sent, long)]
    seen = [shown(size, *each) for each in told]
    assert len({len(lines) for lines in seen}) == 1
    assert len({tuple(line.find("electrodes") for line in lines) for lines in seen}) == 1


@pytest.mark.parametrize(("columns", "rows"), [*itertools.product((1, 7, 30), (1, 6))])
def test_a_terminal_that_is_far_too_small_shows_what_fits(shown, sent, columns, rows):
    assert shown((columns, rows), sent, keys_help="← → rate    ")


def text_of(rows):
    return "\n".join("".join(words for words, _ in row) for row in rows)


@pytest.mark.parametrize("color", [True, False])
def test_an_image_is_seen(color):
    drawn = {text_of(image_rows(printed(*greys), 32, 16, color=color)) for greys in
             ((255, 0), (0, 255), (255, 255), (128, 128), (0, 0))}  # fmt: skip
    assert len(drawn) == (1 if color else 5)
    if color:
        rows = image_rows(printed(255, 0), 32, 16, color=True)
        shades = {style for row in rows for _, style in row}
        assert len(shades) >= 2


@pytest.mark.parametrize("shape", [(64, 64), (480, 640), (1, 255), (255, 1), (1, 1)])
@pytest.mark.parametrize("color", [True, False])
def test_an_image_stays_within_its_place(shape, color):
    lines = text_of(image_rows(np.zeros(shape, np.uint8), 30, 10, color=color)).split("\n")
    assert 1 <= len(lines) <= 10
    assert {len(line) for line in lines} <= {*range(2, 31)}


@pytest.mark.parametrize("name", ["electric-mouse", "kajimoto-61", "optacon-24x6"])
@pytest.mark.parametrize("place", [(60, 20), (24, 8), (5, 3)])
def test_an_array_stays_within_its_place(name, place):
    profile = load_profile(name)
    picture = ArrayPicture(profile)
    parts = np.zeros(len(profile.electrodes.position_mm), np.float32)
    parts[5] = 1
    drawn = text_of(picture.draw(parts, *place))
    lines = drawn.split("\n")
    assert len(lines) <= place[1]
    assert max(map(len, lines)) <= place[0]
    assert drawn.count("●") == 1
    if picture.merged(*place) == 1:
        assert drawn.count("·") == len(parts) - 1


def test_where_there_is_no_image_the_activation_is_drawn(shown, profile, bank):
    activation = np.zeros((3, 64), np.float32)
    activation[Afferent.RA, [9, 27]] = 1, 0.5
    pipeline = Pipeline(profile, bank, RunConfig())
    step = pipeline.process(Stimulus(activation, 0, 1.0, 20_000))
    seen = "\n".join(shown((80, 24), StepResult(step, 1, 0.0)))
    assert sum(seen.count(mark) for mark in MARKS) == 128
    assert seen.count("·") >= 62
    with_image = replace(step, input=replace(step.input, image=printed()))
    assert "▀" in "\n".join(shown((80, 24), StepResult(with_image, 1, 0.0)))


@pytest.mark.parametrize(
    ("terminal", "dumb", "asked", "plain"),
    [(True, False, False, False), (True, True, False, True), (True, False, True, True),
     (False, False, False, True)],
)  # fmt: skip
def test_where_nothing_is_drawn(monkeypatch, terminal, dumb, asked, plain):
    monkeypatch.setenv("TERM", "dumb" if dumb else "xterm")
    console = Console(file=io.StringIO(), force_terminal=terminal)
    monkeypatch.setattr("smarttouch.views.printable_output.console", lambda **_: console)
    run = SimpleNamespace(source=SimpleNamespace(title="a\nb"), profile=SimpleNamespace(title="p"))
    screen = Screen("emulator:", plain=asked)
    screen.event(Paused(1_500_000_000))
    # Events before the board is open are printed when it opens.
    assert console.file.getvalue() == ""
    screen.start(run)
    screen.event(Resumed(2_500_000_000))
    screen.close()
    told = [each for each in console.file.getvalue().splitlines() if not each.startswith("keys")]
    assert told == ["a b, p, emulator:", "1.5 s: paused", "2.5 s: resumed"] * plain


def test_the_summary_says_what_was_counted():
    counted = {
        "rate_asked_hz": 47.0, "rate_hz": 31.5, "slowed_sequences": 4, "lowest_rate_hz": 21.0,
        "lifts": 5, "without_force_or_image": 6, "worst_other": 0.07, "worst_spill": 0.08,
    }  # fmt: skip
    figures = st.run("text:a", "simulated:", seconds=0.5).figures | counted
    summary = "\n".join(summary_lines(figures, acknowledges=True))
    for words in (
        "31.5 Hz of 47.0 Hz requested (4 sequences", "rate was 21.0 Hz", "7% to other classes",
        "8% to other places", "lifted 5 times", "6 sequences without current",
    ):  # fmt: skip
        assert words in summary
