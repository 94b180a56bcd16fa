"""What --scan asks for, and what becomes of it elsewhere."""

import contextlib
import importlib
import inspect

import pytest
from smarttouch.cli.kept import Kept
from smarttouch.cli.plan import Plan
from smarttouch.cli.sharing import parse_scan

from smarttouch.errors import SmartTouchError
from smarttouch.primary import Mode, Primary
from smarttouch.profile import load_profile
from smarttouch.stimulation.frames import NO_SHARING, Sharing


def test_what_scan_asks_for(profile):
    assert parse_scan("auto", profile) == Sharing((Primary.RA,), planned=False)
    assert parse_scan("auto", profile, hold="charge") == NO_SHARING
    assert parse_scan("auto", load_profile("kajimoto-61")) == NO_SHARING
    assert parse_scan("auto", load_profile("line-7")) == NO_SHARING
    assert parse_scan("points", profile) == NO_SHARING
    assert parse_scan("frame", profile) == Sharing(tuple(Primary), planned=True)
    with pytest.raises(SmartTouchError, match="choose points or frame or auto"):
        parse_scan("all", profile)


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


@pytest.mark.parametrize("command", ["live", "read", "legibility"])
def test_it_is_auto_if_nothing_is_asked_for(command):
    module = importlib.import_module(f"smarttouch.cli.{command}")
    assert inspect.signature(getattr(module, command)).parameters["scan"].default == "auto"
