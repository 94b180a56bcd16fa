"""Whose points share slots, by command."""

import importlib
import inspect

import pytest


def test_a_replay_shares_slots_only_where_the_board_can(program_here, figures_of):
    recorded = "live --source text:on?speed_mm_s=200 --board simulated: --quiet"
    program_here(f"{recorded} --record run.mcap").fine()
    figures = figures_of("replay run.mcap --profile kajimoto-61 --board simulated:")
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
