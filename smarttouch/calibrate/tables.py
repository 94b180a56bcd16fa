"""Tables of measurements for the terminal."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from smarttouch import terminal
from smarttouch.terminal import print_table

if TYPE_CHECKING:
    from smarttouch.calibrate.contact import ContactFound
    from smarttouch.calibrate.force_curve import ForceFound
    from smarttouch.calibrate.optics import OpticsFound
    from smarttouch.calibrate.register import RegistrationFound
    from smarttouch.electrodes import ElectrodeArray

_MARKS = {"open": "open", "short": "short", "unsure": "?"}
_NEAR = 0.25
"""Part of a pitch: electrodes whose heights differ by less stand in one row."""


def show_optics(found: "OpticsFound") -> None:
    """Show unevenness, noise and broken pixels."""
    rows = (
        ("blank paper uneven", f"{found.uneven_before:.1%}", f"{found.uneven_after:.1%}"),
        ("dead, hot pixels", f"{found.dead}, {found.hot}", "as the nearest good one"),
        ("dark level", f"{found.dark_level:.1f}", "0"),
        ("noise", f"{found.noise_levels:.2f}", ""),
    )
    print_table(rows, ("", "before", "after"), left=3)


def show_registration(found: "RegistrationFound") -> None:
    """Show the places of electrodes, and the residuals of the dots."""
    outside = set(found.outside.tolist())
    rows = [
        (str(index), f"{column:.2f}", f"{row:.2f}", "beyond the image" * (index in outside))
        for index, (column, row) in enumerate(found.electrode_pixel)
    ]
    print_table(rows, ("electrode", "column", "row", ""), left=4)
    worst = ("worst", float(found.residual_px.max()), found.worst_mm)
    fit = [
        (name, f"{px:.3f}", f"{mm:.4f}", f"{mm / found.pitch_mm:.4f}")
        for name, px, mm in (("rms", found.rms_px, found.rms_mm), worst)
    ]
    print_table(fit, ("residual", "px", "mm", "pitch on the page"), left=4)


def show_force(found: "ForceFound") -> None:
    """Show each weighing, and its force by the curve."""
    rows = []
    for each in found.weighings:
        seen_n = found.force_n(each.reading)
        measured = (f"{each.grams:g}", f"{each.force_n:.4f}", f"{each.reading:.6g}")
        off = f"{seen_n - each.force_n:+.4f}"
        rows.append((*measured, f"{each.spread:.3g}", f"{seen_n:.4f}", off))
    print_table(rows, ("g", "N", "reading", "spread", "by the curve, N", "off, N"), left=6)


def show_contact(found: "ContactFound", electrodes: "ElectrodeArray") -> None:
    """Show the array as it lies under the finger, an impedance at each electrode's place."""
    console = terminal.console()
    width = max(60, console.width)
    rows = _rows(electrodes)
    left = float(electrodes.position_mm[:, 0].min())
    span = float(np.ptp(electrodes.position_mm[:, 0])) or 1.0
    cell = 7
    for row in rows:
        line = [" "] * (width + cell)
        for index in row:
            condition = found.condition[index]
            text = _MARKS.get(condition) or f"{found.kohm[index]:.1f}"
            part = (float(electrodes.position_mm[index, 0]) - left) / span
            at = round(part * min(width - cell, cell * (_widest(rows) - 1)))
            line[at : at + cell] = f"{text:>{cell - 1}} "
        console.print("".join(line).rstrip(), highlight=False, soft_wrap=True)
    console.print("kohm of each electrode where it lies; open, short, ?: not good", style="dim")


def _rows(electrodes: "ElectrodeArray") -> list[list[int]]:
    """Return the electrodes row by row from the top, each row from the left."""
    position = electrodes.position_mm
    rows: list[list[int]] = []
    for index in np.lexsort((position[:, 0], position[:, 1])).tolist():
        above = rows[-1][0] if rows else None
        if above is not None and (
            position[index, 1] - position[above, 1] < _NEAR * electrodes.pitch_mm
        ):
            rows[-1].append(index)
        else:
            rows.append([index])
    return [sorted(row, key=lambda each: float(position[each, 0])) for row in rows]


def _widest(rows: Sequence[Sequence[int]]) -> int:
    # Rows of a hexagon stand between each other: twice as many places as electrodes in a row.
    return max(2, max(len(row) for row in rows))
