"""A session drives a board within its limits, keeps what is done, and stops at once."""

import json
import subprocess
import sys

import numpy as np
import pytest

from smarttouch.boards.memory import MemoryBoard
from smarttouch.calibrate.found import filled, parse_electrodes, sentence
from smarttouch.calibrate.limits import TICK_S, Thresholds
from smarttouch.calibrate.progress import Progress
from smarttouch.calibrate.session import (
    Person,
    Simulated,
    StoppedError,
    ThresholdSession,
    simulated_subjects,
)
from smarttouch.calibrate.stimulus import ceiling_ma, measuring_limits, slew_ma_s
from smarttouch.calibrate.subject import SimulatedSubject
from smarttouch.errors import BoardRestartedError, CalibrationError, LineLostError
from smarttouch.profile import list_profiles, load_profile
from smarttouch.stimulation.safety import SafetyLimits

from ..raising import raises


@pytest.fixture(autouse=True)
def nothing_is_late(monkeypatch):
    """However busy the machine is."""
    monkeypatch.setattr("smarttouch.boards.timely.LATE_NS", 10**15)


@pytest.fixture
def board(profile):
    with MemoryBoard("", measuring_limits(profile), profile.output) as opened:
        yield opened


@pytest.fixture
def begun():
    """Return a beginner of sessions' progress, one after another: the one before has ended."""
    open_ones = []

    def begin(path, settings):
        for each in open_ones:
            each.close()
        open_ones.append(Progress(path, settings))
        return open_ones[-1]

    yield begin
    for each in open_ones:
        each.close()


def subjects(profile, **options):
    count = len(profile.electrodes)
    return Simulated([SimulatedSubject(1.1, 1.9, seed=i, **options) for i in range(count)])


def run(board, profile, subject, sites, progress, **options):
    shown = []
    ThresholdSession(board, profile, subject, **options).run(
        sites, progress, lambda site, found: shown.append(site)
    )
    return shown


@pytest.mark.parametrize("adaptive", [False, True])
def test_every_sequence_goes_through_one_electrode_and_rises_by_the_ramp(
    profile, board, tmp_path, begun, adaptive
):
    progress = begun(tmp_path / "p.json", {})
    run(board, profile, subjects(profile), [3, 9], progress, adaptive=adaptive)
    last_ma, last_ns, sites = 0.0, 0, set()
    for sequence in board.sequences:
        level_ma = float(sequence.source_ua.max(initial=0)) / 1000
        rise_ma = slew_ma_s(profile) * (sequence.time_ns - last_ns) / 1e9
        # To the rounding of a microampere.
        assert level_ma - last_ma <= rise_ma + 1.1e-3
        last_ma, last_ns = level_ma, sequence.time_ns
        sites |= set(sequence.site.tolist())
        assert sequence.slots <= 1
    assert sites == {3, 9}
    assert last_ma == 0
    for site in (3, 9):
        assert progress.found[site].threshold_ma == pytest.approx(1.1, rel=0.2)
        assert progress.found[site].comfort_ma == pytest.approx(1.9, rel=0.2)


def test_runs_begin_at_zero_however_long_the_pause(profile, board, tmp_path, begun):
    run(board, profile, subjects(profile), [0], begun(tmp_path / "p.json", {}))
    levels = np.array([float(each.source_ua.max(initial=0)) for each in board.sequences])
    starts = levels[1:][(levels[:-1] == 0) & (levels[1:] > 0)]
    assert len(starts) >= 3
    assert starts.max() <= 1000 * slew_ma_s(profile) * 2 * TICK_S


@pytest.mark.parametrize("name", list_profiles())
def test_the_ceiling_of_every_profile_is_one_that_its_board_sends(name, tmp_path, begun):
    """Nothing is ever felt: the current goes up to the ceiling, and every proof holds."""
    profile = load_profile(name)
    limits = measuring_limits(profile)
    silent = Simulated([SimulatedSubject(1e3, 1e4, guess=0)] * len(profile.electrodes))
    with MemoryBoard("", limits, profile.output) as board:
        site = len(profile.electrodes) - 1
        progress = begun(tmp_path / "p.json", {})
        run(board, profile, silent, [site], progress, fast=True)
        strongest_ma = max(float(each.source_ua.max(initial=0)) for each in board.sequences) / 1000
        assert strongest_ma == pytest.approx(ceiling_ma(profile, site, board), rel=0.2)
        assert strongest_ma <= profile.limits.current_ma
        assert strongest_ma * profile.pulse.width_us / 1000 <= profile.limits.charge_uc
    assert not progress.found[site].felt
    usual = SafetyLimits.of(profile)
    assert limits.full_ma / limits.ramp_s == pytest.approx(usual.full_ma / usual.ramp_s)


def test_single_electrodes_keep_their_own_limit(profile, changed, tmp_path, begun):
    own = [2.45] * 64
    own[5] = 2.4
    limited = changed(profile, {"limits.electrode_ma": own})
    with MemoryBoard("", measuring_limits(limited), limited.output) as board:
        silent = Simulated([SimulatedSubject(1e3, 1e4, guess=0)] * 64)
        run(board, limited, silent, [5], begun(tmp_path / "p.json", {}))
        assert max(float(each.source_ua.max(initial=0)) for each in board.sequences) == 2400


def test_an_interrupted_session_goes_on_where_it_was(profile, board, tmp_path, begun):
    first = begun(tmp_path / "p.json", {"repeats": 3})

    def stop_after(count):
        return lambda: len(first.found) >= count

    with pytest.raises(StoppedError):
        run(board, profile, subjects(profile), range(5), first, must_stop=stop_after(2))
    assert list(first.found) == [0, 1]
    again = begun(tmp_path / "p.json", {"repeats": 3})
    assert again.found == first.found
    with MemoryBoard("", measuring_limits(profile), profile.output) as second:
        shown = run(second, profile, subjects(profile), range(5), again)
        assert shown == [2, 3, 4]
        assert {int(s) for each in second.sequences for s in each.site} == {2, 3, 4}


def test_a_stop_comes_at_once_and_nothing_is_sent_after(profile, board, tmp_path, begun):
    stopped = []

    def must_stop():
        if board.sequences and float(board.sequences[-1].source_ua.max(initial=0)) > 800:
            stopped.append(len(board.sequences))
        return bool(stopped)

    with pytest.raises(StoppedError):
        run(
            board, profile, subjects(profile), [0], begun(tmp_path / "p.json", {}),
            must_stop=must_stop,
        )  # fmt: skip
    assert len(board.sequences) == stopped[0]
    assert board._stopped.is_set()


class Losing(MemoryBoard):
    """A board that is lost, and back, at these sends."""

    at = ()

    def _send(self, sequence, times):
        if len(self.sequences) in self.at:
            self.at = [each for each in self.at if each != len(self.sequences)]
            raise LineLostError("the line broke")
        return super()._send(sequence, times)

    def _recover(self, lost):
        pass


@pytest.mark.parametrize("adaptive", [False, True])
def test_a_board_that_was_lost_begins_again_at_zero(profile, tmp_path, begun, adaptive):
    progress = begun(tmp_path / "p.json", {})
    with Losing("", measuring_limits(profile), profile.output) as board:
        # In the first run, in the second, and in the trials.
        board.at = [90, 260, 1000] if adaptive else [90, 260]
        run(board, profile, subjects(profile), [0], progress, adaptive=adaptive)
        after = [board.sequences[each] for each in (90, 260)]
        assert [each.slots for each in after] == [0, 0]
        assert len(board.notes) == (3 if adaptive else 2)
    assert progress.found[0].threshold_ma == pytest.approx(1.1, rel=0.2)


def test_a_board_that_is_lost_all_the_time(profile, tmp_path, begun):
    with Losing("", measuring_limits(profile), profile.output) as board:
        board.at = range(50, 90)
        with pytest.raises(BoardRestartedError):
            run(board, profile, subjects(profile), [0], begun(tmp_path / "p.json", {}))


def test_a_person_presses_keys():
    keys = iter(["x", None, None, "y", "n", "?", " "])
    said = []
    person = Person(lambda seconds: next(keys, None), said.append)
    person.begin(3)
    assert person.pressed(1.0, 0.01)
    assert not person.pressed(1.0, 0.0)
    keys = iter([None, "?", "y"])
    assert person.felt(1.0)
    keys = iter(["n"])
    assert not person.felt(1.0)
    assert said[0].startswith("electrode 3")


@pytest.mark.parametrize("key", ["q", "\x1b", ""])
def test_a_person_stops(key):
    """By a key; an empty one means that the terminal is gone."""
    with pytest.raises(StoppedError):
        Person(lambda seconds: key, print).pressed(1.0, 0.5)
    with pytest.raises(StoppedError):
        Person(lambda seconds: None, print, lambda: True).felt(1.0)


def found(threshold=1.0, comfort=2.0):
    return Thresholds(threshold, comfort, 0.05, 3, 1)


def test_what_was_not_measured_stays_as_it_was(profile, changed):
    measured = {
        0: found(),
        1: found(np.nan, np.nan),
        2: found(1.5, 1.5),
        3: found(0.71234, 2.5),
    }
    threshold, comfort = filled(profile, measured)
    assert threshold == [1.0, 1.2, 1.2, 0.712] + [1.2] * 60
    assert comfort == [2.0, 2.4, 2.4, 2.5] + [2.4] * 60
    own = changed(
        profile, {"perception.threshold_ma": [1.1] * 64, "perception.comfort_ma": [2.2] * 64}
    )
    assert filled(own, {5: found()})[1] == [2.2] * 5 + [2.0] + [2.2] * 58
    assert sentence(measured, adaptive=False).startswith("2 ")
    assert "[1, 2]" in sentence(measured, adaptive=True)
    with raises(CalibrationError, about="thresholds", problem="empty"):
        filled(profile, {1: found(np.nan, np.nan)})


@pytest.mark.parametrize(
    ("text", "expected"),
    [("0-3,12", [0, 1, 2, 3, 12]), (" 5 , 5-6", [5, 6]), ("63", [63])],
)
def test_electrodes_by_number_and_range(profile, text, expected):
    assert parse_electrodes(text, profile) == expected


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "malformed"),
        ("a", "malformed"),
        ("3-", "malformed"),
        ("-3", "malformed"),
        ("1;2", "malformed"),
        ("5-2", "unknown"),
        ("64", "unknown"),
        ("0-64", "unknown"),
    ],
)
def test_electrodes_that_are_none(profile, text, problem):
    with raises(CalibrationError, about="electrodes", problem=problem, value=text):
        parse_electrodes(text, profile)


def test_masked_electrodes_are_left_out(profile, changed):
    masked = changed(profile, {"output.masked": (1, 2)})
    assert parse_electrodes(None, masked)[:3] == [0, 3, 4]
    with raises(CalibrationError, about="electrodes", problem="masked", value=2):
        parse_electrodes("2-4", masked)


def test_progress_is_read_back_and_its_settings_count(tmp_path, begun):
    path = tmp_path / "p.json"
    kept = begun(path, {"repeats": 3, "board": "emulator:"})
    kept.keep(4, found())
    kept.keep(1, found(np.nan, np.nan))
    again = begun(path, {"repeats": 3, "board": "emulator:"})
    assert again.found[4] == kept.found[4]
    assert not again.found[1].felt
    with raises(CalibrationError, about="repeats", problem="conflict", value=5):
        begun(path, {"repeats": 5, "board": "emulator:"})
    again.forget()
    assert begun(path, {}).found == {}


def test_two_programs_do_not_go_on_with_one_session(tmp_path):
    path = tmp_path / "p.json"
    code = (
        "import sys; from pathlib import Path; from smarttouch.calibrate.progress import Progress\n"
        "with Progress(Path(sys.argv[1]), {}): print('has it', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline() == "has it\n"
        with raises(CalibrationError, about="file", problem="busy", value=path):
            Progress(path, {})
        other.communicate()
    assert other.returncode == 0
    with Progress(path, {}) as mine:
        mine.keep(4, found())
        # The file is another one now, and still taken.
        with raises(CalibrationError, about="file", problem="busy", value=path):
            Progress(path, {})
    assert [each.name for each in tmp_path.iterdir()] == ["p.json"]
    with Progress(path, {}) as again:
        assert list(again.found) == [4]
        again.forget()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "content",
    [
        "", "[]", "null", "{}", '{"settings": {}, "found": []}',
        '{"settings": {}, "found": {"a": 1}}',
        '{"settings": 1, "found": {"1": {"threshold_ma": 1}}}', "\ud800", "[" * 5000,
        json.dumps({"settings": {}, "found": {"1": {
            "threshold_ma": 3, "comfort_ma": 2, "spread": 0, "runs": 1, "false_presses": 0}}}),
    ],
)  # fmt: skip
def test_progress_that_is_none(tmp_path, begun, content):
    path = tmp_path / "p.json"
    path.write_bytes(content.encode("utf-8", "surrogatepass"))
    with raises(CalibrationError, about="file", problem="malformed", value=path):
        begun(path, {})


def test_simulated_subjects_stay_below_the_ceiling(profile):
    made = simulated_subjects(profile, [2.4] * 64, 3)
    assert all(each.threshold_ma < each.comfort_ma < 2.4 for each in made._subjects)
    assert len({each.threshold_ma for each in made._subjects}) > 30
