"""Classes share slots as far as this computer plans them in time."""

import contextlib

import pytest

from smarttouch.cli import sharing
from smarttouch.cli.kept import Kept
from smarttouch.cli.plan import Plan
from smarttouch.cli.sharing import kept_up_with, parse_scan, planning_s
from smarttouch.errors import SmartTouchError
from smarttouch.modes.bank import load_bank
from smarttouch.primary import Mode, Primary
from smarttouch.profile import load_profile

BOTH = (Primary.RA, Primary.SAI)


def test_what_scan_asks_for(profile):
    assert parse_scan("auto", profile) == BOTH
    assert parse_scan("auto", profile, hold="charge") == ()
    assert parse_scan("auto", load_profile("optacon-24x6")) == (Primary.RA,)
    assert parse_scan("auto", load_profile("kajimoto-61")) == ()
    assert parse_scan("points", profile) == ()
    assert set(BOTH) <= set(parse_scan("frame", profile))
    with pytest.raises(SmartTouchError, match="choose points or frame or auto"):
        parse_scan("all", profile)


@pytest.mark.parametrize(
    ("rate_hz", "ra_s", "sai_s", "left"),
    [
        (None, 0.009, 0.009, BOTH),
        (None, 0.009, 0.011, (Primary.RA,)),
        (100.0, 0.006, 0.004, (Primary.SAI,)),
        (None, 1.0, 1.0, ()),
    ],
)
def test_what_takes_longer_than_half_a_period_is_shown_point_by_point(
    profile, bank, monkeypatch, rate_hz, ra_s, sai_s, left
):
    took_s = {Primary.RA: ra_s, Primary.SAI: sai_s}
    monkeypatch.setattr(sharing, "planning_s", lambda _profile, _bank, each: took_s[each])
    plan = Plan("", "simulated:", Mode.RA, rate_hz, at_once=BOTH)
    notes, classes = kept_up_with(plan, profile, bank)
    assert classes == left
    assert [note.split()[0] for note in notes] == [
        each.name for each in BOTH if each not in classes
    ]


def test_classes_that_the_board_does_not_have_are_not_tried(monkeypatch):
    profile = load_profile("kajimoto-61")
    bank = load_bank(profile)
    assert Primary.SAI not in bank.weights
    monkeypatch.setattr(sharing, "planning_s", lambda *_: 0.0)
    plan = Plan("", "simulated:", Mode.RA, at_once=BOTH)
    assert kept_up_with(plan, profile, bank) == ([], BOTH)


def test_plans_are_timed(profile, bank):
    assert 1e-4 < planning_s(profile, bank, Primary.RA) < 5


def test_a_run_that_cannot_be_planned_in_time_says_so(program_here, tmp_path):
    """No computer plans 26 SAI points in 2.5 ms."""
    options = ("--rate", 200, "--seconds", 1, "--json", "run.json")
    done = program_here("live", "--mode", "SAI", *options)
    assert done.returncode == 0, done.stderr
    assert "SAI is shown point by point" in done.stdout
    assert "points shared slots" not in done.stdout


def test_a_replay_shares_slots_only_where_the_board_can(program_here, tmp_path):
    recorded = ("live", "--sensor", "text:on", "--speed", 200, "--board", "simulated:", "--quiet")
    assert program_here(*recorded, "--record", "run.mcap").returncode == 0
    other = ("--profile", "kajimoto-61", "--board", "simulated:", "--json", "run.json")
    done = program_here("replay", "run.mcap", *other)
    assert done.returncode == 0, done.stderr
    assert "points shared slots" not in done.stdout


def test_notes_of_markers_do_not_replace_others(profile, monkeypatch):
    class Markers:
        def __init__(self, profile):
            self.notes = []

        close = event = watch = staticmethod(lambda *_: None)

    made = []
    monkeypatch.setattr(
        "smarttouch.markers.Markers", lambda profile: made.append(Markers(profile)) or made[-1]
    )
    with contextlib.ExitStack() as stack:
        kept = Kept(Plan("", "simulated:", Mode.RA, markers=True), stack)
        kept.notes.append("one")
        kept._mark(profile)
        made[-1].notes.append("two")
    assert kept.notes == ["one", "two"]
