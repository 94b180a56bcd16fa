"""Common parts of the drivers of kits: current per DAC count, and slots for a single source.

The measured current of a count may differ from the nominal one by 30 %. This covers the differences
between boards of one kind. The check still detects errors: another board of the family changes the
current by a factor of 1.77 or more, a peak-to-peak value by 2, a wrong unit by 1,000.
"""

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError
from smarttouch.profile.kit_scales import NOMINAL_UA, require_in_band
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

BOOT_S = 1.0  # time to boot: kits reset when their port is opened


def require_kit(kind: str, port: str, output: Output | None, profile: str) -> float:
    """Return the current per DAC count, µA: as measured if ``output`` states it, otherwise nominal.
    Raises BoardError if the port is missing or the profile does not suit the kit."""
    if not port:
        raise BoardError(f"{kind}: needs a port, for example {kind}:/dev/ttyUSB0")
    if output is not None and output.kind != "one-against-all":
        raise BoardError(
            f"a {kind} board is one-against-all, but the profile needs {output.kind}: use profile "
            f"{profile}"
        )
    measured_ua = None if output is None else output.ua_per_count
    if measured_ua is None:
        return NOMINAL_UA[kind]
    require_in_band(measured_ua / NOMINAL_UA[kind], f"output.ua_per_count = {measured_ua:g}")
    return measured_ua


def steps_of(
    kind: str, scale_ua: float, limits: SafetyLimits, width_us: float, level_ua: NDArray[np.int64],
    electrode: NDArray[np.intp], counts: int = 1,
) -> NDArray[np.int64]:  # fmt: skip
    """Convert the current of each slot, (S,) µA, to a whole number of steps. A step is ``counts``
    DAC counts. The result keeps the limits of current and charge in both cases: if a count causes
    its measured current, ``scale_ua``, and if a count causes its nominal current."""
    most_ua = np.minimum(limits.current_ua, limits.charge_pc / max(float(width_us), 1.0))
    # Without 1e-9, a rounding error could reduce a limit of exactly n steps to n - 1 steps.
    most = np.floor(most_ua / (counts * max(scale_ua, NOMINAL_UA[kind])) + 1e-9)[electrode]
    return np.minimum(np.rint(level_ua / (counts * scale_ua)), most).astype(np.int64)


def one_against_all(sequence: ScanSequence) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Return two arrays, (S,): the electrode that each slot drives against all others, and the
    current of this electrode, µA (cathodic is positive). Raises BoardError if a slot drives
    electrodes in another way, or if two slots drive the same electrode."""
    current = sequence.current_ua.astype(np.int64)
    electrode = sequence.site.astype(np.intp)
    rows = np.arange(sequence.slots)
    alone_ua = current[rows, electrode]
    others = current * np.sign(alone_ua)[:, None]
    others[rows, electrode] = 0
    wrong = (others > 0).any(axis=1) | (np.abs(current).max(axis=1, initial=0) > np.abs(alone_ua))
    if wrong.any():
        raise BoardError(
            f"slot {int(wrong.argmax())} does not drive one electrode against all others, as "
            "this board requires: use the profile of the board",
            slot=int(wrong.argmax()),
        )
    if len(np.unique(electrode)) != len(electrode):
        raise BoardError(
            f"{len(electrode)} slots share {len(np.unique(electrode))} electrodes, but this "
            "board drives each once per scan: send one slot for each electrode"
        )
    return electrode, alone_ua
