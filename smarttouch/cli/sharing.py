"""Whose points share slots: what ``--scan`` asks for, as far as this computer keeps up."""

import time
from typing import TYPE_CHECKING

import numpy as np

from smarttouch.cli.files import parse_choice
from smarttouch.primary import Primary

if TYPE_CHECKING:
    from smarttouch.cli.plan import Plan
    from smarttouch.modes.bank import KernelBank
    from smarttouch.profile import Profile

_ACTIVE = 0.4
"""Of all points: much ink under the finger."""
_TRIES = 4
_SHARE = 0.5
"""Part of a period that a plan may take; the rest is for all else."""


def parse_scan(scan: str, profile: "Profile", hold: str | None = None) -> tuple[Primary, ...]:
    """Return the classes that ``--scan`` lets share slots; of itself none where ``--hold`` is."""
    from smarttouch.scan.frames import in_time

    chosen = parse_choice("--scan", scan, ("points", "frame", "auto"))
    if chosen == "auto":
        return () if hold else in_time(profile)
    return tuple(Primary) if chosen == "frame" else ()


def kept_up_with(
    plan: "Plan", profile: "Profile", bank: "KernelBank"
) -> tuple[list[str], tuple[Primary, ...]]:
    """Return those classes of a plan that this computer plans frames of in time, and notes."""
    allowed_s = _SHARE / (plan.rate_hz or profile.pulse.rate_hz)
    notes, classes = [], []
    for each in plan.at_once:
        if each in bank.weights and (took_s := planning_s(profile, bank, each)) > allowed_s:
            notes.append(
                f"{each.name} is shown point by point: a frame takes this computer "
                f"{1000 * took_s:.0f} ms to plan; --scan frame does so anyway"
            )
        else:
            classes.append(each)
    return notes, tuple(classes)


def planning_s(profile: "Profile", bank: "KernelBank", primary: Primary) -> float:
    """Return how long a frame with many points takes to plan, s; the shortest of a few."""
    from smarttouch.scan.frames import FrameSlots

    slots, count = FrameSlots(profile, bank, (primary,)), len(profile.electrodes)
    random, spent = np.random.default_rng(1), []
    for _ in range(_TRIES):
        activation = random.random((1, count), np.float32) * (random.random((1, count)) < _ACTIVE)
        start = time.perf_counter()
        slots.slots(activation.astype(np.float32), 1.0)
        spent.append(time.perf_counter() - start)
    return min(spent)
