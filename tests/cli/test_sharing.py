"""Whose points share slots, by command."""

import importlib
import inspect
import json

import pytest


def test_a_replay_shares_slots_only_where_the_board_can(program_here, tmp_path):
    recorded = "live --source text:on?speed_mm_s=200 --board simulated: --quiet"
    assert program_here(*recorded, "--record", "run.mcap").returncode == 0
    other = ("--profile", "kajimoto-61", "--board", "simulated:", "--json", "run.json")
    program_here("replay", "run.mcap", *other).fine()
    figures = json.loads((tmp_path / "run.json").read_text())
    assert figures["slots"] > 0
    assert figures["worst_other"] is figures["worst_spill"] is None


@pytest.mark.parametrize(
    ("module", "command", "scan"),
    [
        ("live", "live", "auto"), ("read", "read", "auto"), ("legibility", "legibility", "auto"),
        ("mouse", "mouse", "points"), ("color", "color", "points"),
        ("experiment", "free", "points"),
    ],
)  # fmt: skip
def test_what_it_is_if_nothing_is_asked_for(module, command, scan):
    found = getattr(importlib.import_module(f"smarttouch.cli.{module}"), command)
    assert inspect.signature(found).parameters["scan"].default == scan
