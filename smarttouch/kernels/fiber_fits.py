"""Fits of driving functions, and their errors on kernels and fibers that they have not seen."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.kernels.bank import KernelBank
from smarttouch.kernels.fiber_cases import FiberCases, along_mm, cases
from smarttouch.physiology.driving import FIBERS, DrivingFunction, End, as_table
from smarttouch.physiology.fiber_fit import ThresholdError, activating, fit, threshold_error
from smarttouch.physiology.membrane import Fiber, threshold_ma, thresholds_ma
from smarttouch.profile import Profile

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

WIDTHS_US = (50.0, 100.0, 200.0, 500.0)
_EARLY = 0.3
"""Where the search for thresholds begins, of what the activating function predicts."""
_FADED = 0.3
"""Slope at a cut, relative to the largest bend, below which a field counts as faded there."""
_FEWER = 3
"""Every third case of the MRG model, which takes seconds each."""


@dataclass(frozen=True, eq=False)
class FiberFit:
    """Driving function of one fiber, ending and pulse width, with its errors.

    Attributes
    ----------
    fiber : str
    width_us : float, µs
    driving : DrivingFunction
    fitted : ThresholdError
        On the cases that it was fitted to.
    held_out : dict of str to ThresholdError
        On other cases: "all", and by group and polarity.
    activating : ThresholdError
        Of the activating function on the same other cases.
    """

    fiber: str
    width_us: float
    driving: DrivingFunction
    fitted: ThresholdError
    held_out: dict[str, ThresholdError]
    activating: ThresholdError


def ends_of(fiber: str) -> tuple[End, ...]:
    """Return the endings that a fiber is offered with; bare terminals only at the fingertip."""
    return ("through", "active", "passive") if fiber == "fingertip" else ("through", "active")


def fit_fiber(
    profile: Profile,
    bank: KernelBank,
    fiber: str,
    widths_us: Sequence[float] = WIDTHS_US,
    progress: Progress = lambda _done, _all: None,
) -> list[FiberFit]:
    """Fit a fiber with each of its endings, and judge it on kernels of other sites.

    Parameters
    ----------
    profile : Profile
    bank : KernelBank
        Kernels of RA and SAI.
    fiber : str
        One of `driving.FIBERS`; "mrg" needs PyFibers.
    widths_us : sequence of float, µs
    progress : callable
        Is given the number of finished fits and of all.
    """
    found = []
    ends = ends_of(fiber)
    for end in ends:
        seen, unseen = (cases(profile, bank, end != "through", other) for other in (False, True))
        for width in widths_us:
            found.append(_fit_one(fiber, end, width, seen, unseen))
            progress(len(found), len(ends) * len(widths_us))
    return found


def _fit_one(
    name: str, end: End, width_us: float, seen: FiberCases, unseen: FiberCases
) -> FiberFit:
    fiber = replace(FIBERS[name], end=end)
    if name == "mrg":
        thin = np.arange(len(seen.group)) % _FEWER == 0
        seen, unseen = seen[thin], unseen[thin]
    reach_mm = 4.0 if fiber.internode_mm < 0.2 else 8.0
    potentials, thresholds = [], []
    for each in (seen, unseen):
        potentials.append(each.potential_mv(along_mm(end, fiber.internode_mm, reach_mm)))
        thresholds.append(_thresholds(name, fiber, width_us, each, potentials[-1]))
    reach = 12 if fiber.internode_mm < 0.2 else 8
    driving = fit(fiber, width_us, potentials[0], thresholds[0], reach)
    plain = activating(fiber, potentials[0], thresholds[0])
    highest = _highest(driving, potentials[1])
    names = np.array(
        [f"{g} {'+' if c else '-'}" for g, c in zip(unseen.group, unseen.cathodic, strict=True)]
    )
    held_out = {"all": threshold_error(highest, thresholds[1])}
    for group in dict.fromkeys(names):
        which = names == group
        held_out[str(group)] = threshold_error(highest[which], thresholds[1][which])
    return FiberFit(
        name,
        width_us,
        driving,
        threshold_error(_highest(driving, potentials[0]), thresholds[0]),
        held_out,
        threshold_error(_highest(plain, potentials[1]), thresholds[1]),
    )


def _highest(driving: DrivingFunction, potential_mv: Array) -> Array:
    return np.asarray(driving.drive(potential_mv[..., None])[..., 0].max(axis=1))


def _thresholds(
    name: str, fiber: Fiber, width_us: float, each: FiberCases, potential_mv: Array
) -> Array:
    near_ma = _near(fiber, width_us, potential_mv)
    if name != "mrg":
        return thresholds_ma(potential_mv, fiber, width_us, near_ma, step_us=width_us / 50)
    from smarttouch.physiology.mrg import MrgFiber

    model = MrgFiber("active" if fiber.end == "active" else "through")
    thresholds = model.thresholds_ma(each.potential_mv(model.along_mm), width_us, near_ma)
    return np.where(_cut_counts(fiber, potential_mv), np.nan, thresholds)


def _cut_counts(fiber: Fiber, potential_mv: Array) -> NDArray[np.bool_]:
    """Return where a field has not faded at the cut of a fiber that should go on, (C,)."""
    slopes = -np.diff(potential_mv, axis=1)
    cut = slopes[:, -1] if fiber.end == "active" else np.maximum(slopes[:, -1], -slopes[:, 0])
    return np.asarray(cut > _FADED * np.diff(potential_mv, 2, axis=1).max(axis=1))


def _near(fiber: Fiber, width_us: float, potential_mv: Array) -> Array:
    """Return where to begin to look for the thresholds, mA: well below them."""
    first = threshold_ma(potential_mv[0], fiber, width_us, cathodic=True, step_us=5.0)
    bends = np.diff(potential_mv, 2, axis=1).max(axis=1)
    if fiber.end == "active":
        bends = np.maximum(bends, potential_mv[:, 1] - potential_mv[:, 0])
    reference = max(float(bends[0]), 1e-9)
    ratio = np.clip(reference / np.maximum(bends, 1e-9), 0.1, 100.0)
    return np.asarray(_EARLY * first * ratio)


def as_json(fits: Sequence[FiberFit]) -> dict[str, Any]:
    """Return the weights by fiber, ending and pulse width, as they ship."""
    table: dict[str, Any] = {}
    for each in fits:
        by_end = table.setdefault(each.fiber, {}).setdefault(each.driving.end, {})
        by_end[f"{each.width_us:g}"] = as_table(each.driving)
    return table


def error_rows(fits: Sequence[FiberFit]) -> list[list[str]]:
    """Return a heading, and a row of errors in per cent for each fit."""
    heading = ["fiber", "ending", "µs", "cases", "median", "90 %", "worst", "worst group's 90 %",
               "AF median", "AF 90 %", "AF worst"]  # fmt: skip
    rows = [heading]
    for each in fits:
        held, plain = each.held_out["all"], each.activating
        group = max((name for name in each.held_out if name != "all"),
                    key=lambda name: each.held_out[name].tenth)  # fmt: skip
        errors = (held.median, held.tenth, held.worst)
        others = (plain.median, plain.tenth, plain.worst)
        rows.append(
            [each.fiber, each.driving.end, f"{each.width_us:g}", str(held.cases)]
            + [f"{100 * value:.1f}" for value in errors]
            + [f"{100 * each.held_out[group].tenth:.1f} ({group})"]
            + [f"{100 * value:.0f}" for value in others]
        )
    return rows
