"""The line cue appears while the finger is above or below the line of print, not while on it."""

import math

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ScheduleError
from smarttouch.profile import load_profile
from smarttouch.running.replay_check import assert_replays
from smarttouch.sources.source_contract import Frame
from smarttouch.sources.virtual_finger import FingerPath, PageSource
from smarttouch.stimulation.line_cue import LineCueMapper

from ..pages.printed import print_page, some_lines
from ..support.full import sample


@pytest.fixture(scope="module")
def printed():
    return print_page(some_lines(4, 50), size_pt=12, font="DejaVuSerif")


@pytest.fixture(scope="module")
def frames_at(printed):
    """Return a function that yields 30 frames along the second line of print, from a turned finger
    whose center is ``below_mm`` below the middle of the lowercase letters."""

    def make(profile, below_mm, angle_deg=0.0):
        line, source = printed.lines[1], PageSource(printed.page, profile, "page")
        points = line.baseline_mm
        for index, x_mm in enumerate(np.linspace(points[0, 0] + 3, points[-1, 0] - 3, 30)):
            y_mm = points[0, 1] - line.x_height_mm / 2 + below_mm
            place = np.array([x_mm, y_mm, math.radians(angle_deg), 1.0])
            source.path = FingerPath(np.stack([np.append(0, place), np.append(99, place)], axis=1))
            source.duration_s = None
            yield source.read(index * 20_000_000)

    return make


# Lines of print are 4.3 mm high, with a pitch of 5.3 mm.
CUES = {-2: "last", -1.5: "last", -0.4: "", 0: "", 0.4: "", 1.5: "first", 2: "first"}


@pytest.mark.parametrize("angle_deg", [-5, 0, 5])
@pytest.mark.parametrize(("below_mm", "cue"), sample(CUES.items(), 3))
@pytest.mark.parametrize("mode", [Mode.RA, Mode.NATURAL])
def test_the_row_towards_the_line_is_driven(profile, frames_at, below_mm, angle_deg, cue, mode):
    mapper, counts = LineCueMapper(profile), {"first": 0, "last": 0}
    for frame in frames_at(profile, below_mm, angle_deg):
        rows = mapper.map(frame, mode).activation[Afferent.RA].reshape(8, 8)
        counts["first"] += bool((rows[0] == 1).all())
        counts["last"] += bool((rows[-1] == 1).all())
    wrong = sum(count for row, count in counts.items() if row != cue)
    # Allow errors in 3 of 30 frames, because interpolation differs between versions of OpenCV.
    assert wrong <= 3
    assert not cue or counts[cue] >= 20


def test_baseline_height_and_angle_are_those_of_the_print(printed, profile, frames_at):
    mapper, places = LineCueMapper(profile), []
    for frame in frames_at(profile, 0.8, angle_deg=5.0):
        mapper.map(frame, Mode.RA)
        places.append(mapper.line)
    x_mm = printed.lines[1].x_height_mm
    baseline_mm, height_mm, angle_deg = np.median(places, axis=0)
    assert baseline_mm == pytest.approx(x_mm / 2 - 0.8, abs=0.3)
    assert height_mm == pytest.approx(x_mm, rel=0.2)
    assert angle_deg == pytest.approx(-5.0, abs=2.5)


def test_blank_paper_has_no_line(profile):
    mapper = LineCueMapper(profile)
    blank = Frame(np.full((64, 64), 220, np.uint8), 0, force_n=1.0)
    assert not mapper.map(blank, Mode.RA).activation.any()
    assert mapper.line is None


def test_other_arrays_have_a_border_too(frames_at):
    profile = load_profile("kajimoto-61")
    mapper, rows = LineCueMapper(profile), profile.electrodes.position_mm[:, 1].round(3)
    driven = [
        mapper.map(frame, Mode.RA).activation[Afferent.RA] for frame in frames_at(profile, 1.6)
    ]
    assert sum(bool(each[rows == rows.min()].all()) for each in driven) >= 20


def test_two_rows_are_too_few(profile):
    table = profile.model_dump()
    table["array"] |= {"rows": 2}
    with pytest.raises(ScheduleError, match="three rows"):
        LineCueMapper(type(profile).model_validate(table))


def test_a_run_with_the_cue_is_proved_and_reproduced(profile, printed, tmp_path):
    """Below the line of print, the board drives all of the first row with the cue, not without."""
    points = printed.lines[1].baseline_mm
    y_mm = points[0, 1] - printed.lines[1].x_height_mm / 2 + 1.5
    driven = {}
    for cue in (True, False):
        source = PageSource(printed.page, profile, "page")
        source.path = FingerPath(np.array([[0.0, 2], [20, 60], [y_mm, y_mm], [0, 0], [1, 1]]))
        source._lasts_s = source.duration_s = 2.0
        results = []
        listeners = [results.append, st.Recorder(tmp_path / f"{cue}.mcap")]
        st.run(source, "simulated:", line_cue=cue, listeners=listeners)
        full = [result.delivered_ma.reshape(8, 8)[0].all() for result in results]
        driven[cue] = np.mean(full)
        assert_replays(tmp_path / f"{cue}.mcap")
    assert driven[True] > 0.5 > 0.1 > driven[False]
