"""Driving functions of free endings: unmyelinated, so that a linear cable predicts what fires.

An unmyelinated fiber is a cable of one membrane. In the 200 µs of a pulse its potential moves by
some hundredths of a millimeter only, and it fires where the pulse leaves it depolarized by about
16 mV. With the membrane of Hodgkin and Huxley at 20 °C, diameters of 0.3 to 1 µm and depths of 0.3
to 0.5 mm, under a disc or at its edge, it fires at 1.0 to 1.25 times the cathodic current so
predicted, and at 0.65 to 0.9 times the anodic (`tests/physiology/test_free_endings.py`).
"""

import numpy as np
from scipy.linalg import expm

from smarttouch.physiology.driving import DrivingFunction

STEP_MM = 0.025
"""Distance of the places at which the cable is looked at."""
THRESHOLD_MV = 16.0
"""Depolarization at the end of a pulse that fires: see above."""
_AXOPLASM_OHM_CM, _UF_PER_CM2, _LEAK_MS_PER_CM2 = 100.0, 1.0, 0.3
_REACH, _OWN_NODES, _OWN_REACH, _NODES = 16, 8, 24, 80


def free_ending(
    diameter_um: float, width_us: float, threshold_mv: float = THRESHOLD_MV
) -> DrivingFunction:
    """Return the driving function of an unmyelinated fiber with a sealed ending."""
    step_cm, farad = STEP_MM / 10, _UF_PER_CM2 * 1e-6
    coupling = diameter_um * 1e-4 / (4 * _AXOPLASM_OHM_CM * step_cm**2 * farad) / 1e6  # 1/µs
    bend = np.eye(_NODES, k=1) + np.eye(_NODES, k=-1)
    bend -= np.diag(bend.sum(axis=1))
    rates = coupling * bend - _LEAK_MS_PER_CM2 / _UF_PER_CM2 / 1000 * np.eye(_NODES)
    answer = coupling * np.linalg.solve(rates, expm(rates * width_us) - np.eye(_NODES))
    answer /= threshold_mv
    middle = _NODES // 2
    return DrivingFunction(
        STEP_MM,
        "active",
        np.asarray(answer[middle, middle : middle + _REACH + 1], np.float64),
        np.asarray(answer[:_OWN_NODES, :_OWN_REACH], np.float64),
    )
