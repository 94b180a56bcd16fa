"""Fit driving functions to a cable model of a fiber, and test them on kernels outside the fit.

    python examples/fit_fibers/fit_driving_functions.py fingertip

This command prints the errors of predicted thresholds. ``--json FILE`` writes the weights in the
format of the package. ``fingertip`` and ``trunk`` take one or two minutes. ``mrg`` takes one or two
hours, resumes an interrupted run, and needs NEURON and PyFibers: run
``pip install "neuron>=9" "pyfibers>=0.13"``, then ``pyfibers_compile`` once.
"""

import argparse
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mrg
import numpy as np
import platformdirs
from fiber_cases import FiberCases, along_mm, cases
from fiber_fit import ThresholdError, activating, fit, threshold_error, thresholds_ma
from numpy.typing import NDArray

from smarttouch.base.files import require_folder, write_json
from smarttouch.kernels.bank import KernelBank, load_bank
from smarttouch.physiology.membrane import (
    FIBERS,
    DrivingFunction,
    End,
    Fiber,
    load_driving,
)
from smarttouch.profile import Profile, load_profile
from smarttouch.views.printable_output import print_table
from smarttouch.views.progress import progress

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

WIDTHS_US = (50.0, 100.0, 200.0, 500.0)
_MOST_MA = 50.0
"""Threshold above which a fiber counts as never firing: ten times the largest legal current."""
_FEWER = 3
"""The MRG model computes only every third case, because a case takes seconds."""
_AT_ONCE = 10  # number of MRG cases whose thresholds are stored in one file


@dataclass(frozen=True, eq=False)
class FiberFit:
    """Driving function of one fiber, ending and pulse width, with its errors."""

    fiber: str
    width_us: float
    driving: DrivingFunction
    fitted: ThresholdError  # errors on the cases that were used in the fit
    # Errors on the cases for testing. The key "all" means all cases. The other keys state a group
    # and a polarity, for example "RA +".
    held_out: dict[str, ThresholdError]
    activating: ThresholdError  # errors of the activating function on the cases for testing


def ends_of(fiber: str) -> tuple[End, ...]:
    """Return the kinds of ending for which a fiber is fitted. Only the fiber "fingertip" is fitted
    with a "passive" ending."""
    return ("through", "active", "passive") if fiber == "fingertip" else ("through", "active")


def fit_fiber(
    profile: Profile,
    bank: KernelBank,
    fiber: str,
    widths_us: Sequence[float] = WIDTHS_US,
    progress: Progress = lambda _done, _all: None,
    keep: Path | None = None,
) -> list[FiberFit]:
    """Fit a fiber for each ending and pulse width. Test each fit on kernels that it did not use.

    Parameters
    ----------
    profile : Profile
    bank : KernelBank
        Kernels of RA and SAI.
    fiber : str
        Name in `membrane.FIBERS`; "mrg" needs PyFibers.
    widths_us : sequence of float, µs
    progress : callable
        Called with the number of finished fits and the number of all fits.
    keep : Path, optional
        Folder that stores thresholds of the MRG model, so that an interrupted run can be resumed.
    """
    found = []
    ends = ends_of(fiber)
    for end in ends:
        seen, unseen = (cases(profile, bank, end != "through", other) for other in (False, True))
        for width in widths_us:
            found.append(_fit_one(fiber, end, width, seen, unseen, keep))
            progress(len(found), len(ends) * len(widths_us))
    return found


def _fit_one(
    name: str,
    end: End,
    width_us: float,
    seen: FiberCases,
    unseen: FiberCases,
    keep: Path | None = None,
) -> FiberFit:
    fiber = replace(FIBERS[name], end=end)
    if name == "mrg":
        thin = np.arange(len(seen.group)) % _FEWER == 0
        seen, unseen = seen[thin], unseen[thin]
    reach_mm = 4.0 if fiber.internode_mm < 0.2 else 15.0 if name == "mrg" else 8.0
    potentials, thresholds = [], []
    for each in (seen, unseen):
        potentials.append(each.potential_mv(along_mm(end, fiber.internode_mm, reach_mm)))
        thresholds.append(_thresholds(name, fiber, width_us, each, potentials[-1], keep))
    reach = 16 if fiber.internode_mm < 0.2 else 8
    driving = fit(fiber, width_us, potentials[0], thresholds[0], reach)
    plain = activating(fiber, potentials[0], thresholds[0])
    highest = driving.highest(potentials[1])
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
        threshold_error(driving.highest(potentials[0]), thresholds[0]),
        held_out,
        threshold_error(plain.highest(potentials[1]), thresholds[1]),
    )


def _thresholds(
    name: str,
    fiber: Fiber,
    width_us: float,
    each: FiberCases,
    potential_mv: Array,
    keep: Path | None,
) -> Array:
    """Return the thresholds of the cable model, (C,) mA; NaN above `_MOST_MA`."""
    if name != "mrg":
        found = thresholds_ma(potential_mv, fiber, width_us, step_us=width_us / 50)
    else:
        found = _mrg_thresholds(fiber, width_us, each, potential_mv, keep)
    return np.where(found > _MOST_MA, np.nan, found)


def _mrg_thresholds(
    fiber: Fiber, width_us: float, each: FiberCases, potential_mv: Array, keep: Path | None
) -> Array:
    """Return thresholds of the MRG model. Load those stored in ``keep``; compute the others."""
    model = mrg.MrgFiber("active" if fiber.end == "active" else "through")
    # Estimates from the shipped driving function make the search faster.
    near_ma = 1 / np.maximum(load_driving("mrg", fiber.end, width_us).highest(potential_mv), 1e-3)
    fields = each.potential_mv(model.along_mm)
    found = []
    for first in range(0, len(fields), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        digest = hashlib.sha256(fields[part].tobytes()).hexdigest()[:16]
        path = keep and keep / f"mrg-{fiber.end}-{width_us:g}-{digest}.npy"
        if path is not None and path.exists():
            found.append(np.load(path))
            continue
        found.append(model.thresholds_ma(fields[part], width_us, near_ma[part]))
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            half = path.with_suffix(".part.npy")
            np.save(half, found[-1])
            half.replace(path)
    return np.concatenate(found)


def as_json(fits: Sequence[FiberFit]) -> dict[str, Any]:
    """Return the weights by fiber, ending and pulse width, in the format of the package."""
    table: dict[str, Any] = {}
    for each in fits:
        by_end = table.setdefault(each.fiber, {}).setdefault(each.driving.end, {})
        by_end[f"{each.width_us:g}"] = weights_of(each.driving)
    return table


def weights_of(driving: DrivingFunction) -> dict[str, Any]:
    """Return the weights of a driving function for a JSON file, rounded to five digits."""
    table: dict[str, Any] = {} if np.isinf(driving.block) else {"block": driving.block}
    return table | {
        "along": [float(f"{weight:.5g}") for weight in driving.along],
        "near_end": [[float(f"{weight:.5g}") for weight in row] for row in driving.near_end],
    }


def error_rows(fits: Sequence[FiberFit]) -> list[list[str]]:
    """Return a heading, and a row of errors in per cent for each fit."""
    heading = ["fiber", "ending", "µs", "cases", "median", "90 % quantile", "worst",
               "90 % quantile, worst group",
               "AF median", "AF 90 % quantile", "AF worst"]  # fmt: skip
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


def main() -> None:
    """Fit a fiber, print the errors, and write the weights."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("fiber", choices=tuple(FIBERS), nargs="?", default="fingertip")
    parser.add_argument("--profile", default="electric-mouse", help="name or file of a profile")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the weights to a file")
    asked = parser.parse_args()
    require_folder(asked.json)
    profile = load_profile(asked.profile)
    keep = platformdirs.user_cache_path("smarttouch") / "fibers"
    with progress("Fitting") as advance:
        fits = fit_fiber(profile, load_bank(profile), asked.fiber, progress=advance, keep=keep)
    heading, *rows = error_rows(fits)
    print("Errors of predicted thresholds in %, on kernels that were not used in the fit")
    print_table(rows, heading, left=2)
    print("AF: errors of the activating function, whose scale is fitted to the cases of the fit.")
    if asked.json is not None:
        write_json(asked.json, as_json(fits))


if __name__ == "__main__":
    main()
