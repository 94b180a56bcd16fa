"""Boards on which no finger is, whose time is what sequences state."""

from smarttouch.boards.board import Board
from smarttouch.boards.open import MemoryDriver
from smarttouch.stimulation.safety_gate import SafetyLimits


def played(profile, kind=MemoryDriver, **options):
    """Return the board of a profile, with a driver of this kind."""
    limits = SafetyLimits.of(profile)
    driver = kind("", limits, profile.output)
    usual = {"on_a_finger": False, "claimed_time": True}
    return Board(driver, limits, profile.output, **(usual | options))
