"""Thresholds of the MRG fiber model, computed by PyFibers with NEURON.

MRG is the double-cable model of McIntyre, Richardson and Grill (J. Neurophysiol. 87, 2002), with
sodium and potassium channels, paranodes and myelin. PyFibers interpolates it to any diameter. Run
``pip install "neuron>=9" "pyfibers>=0.13"``, then ``pyfibers_compile`` once.
"""

import logging
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import DesignError

Array = NDArray[np.float64]

# _STEP_MS: time step of the simulation. _STOP_MS: time that is simulated after the pulse.
_STEP_MS, _STOP_MS = 0.01, 1.5
# _RUNG: ratio of successive currents in the search. _PRECISION: relative error of the result.
_RUNG, _PRECISION = 1.15, 0.01
# First and largest current of the search, relative to the estimated threshold.
_START, _MOST = 0.6, 50.0


class MrgFiber:
    """MRG fiber that computes thresholds for given potentials along it.

    Parameters
    ----------
    end : {"through", "active"}
        "active" if the first node is a sealed ending; "through" if the fiber has no ending.
    diameter_um : float, µm
    nodes : int, optional
        Odd number of nodes. By default the fiber extends 15 mm to each side, or 15 mm from its
        ending. That far away, the field of an array is too weak to fire the cut end.

    Raises
    ------
    DesignError
        If PyFibers or NEURON is missing.
    """

    def __init__(
        self,
        end: Literal["through", "active"],
        diameter_um: float = 5.7,
        nodes: int | None = None,
    ) -> None:
        try:
            from pyfibers import FiberModel, build_fiber
        except (ImportError, OSError) as error:
            raise DesignError(
                f"PyFibers and NEURON, which the MRG model needs, cannot be loaded ({error}): run "
                'pip install "neuron>=9" "pyfibers>=0.13", then pyfibers_compile'
            ) from None
        logging.getLogger("pyfibers").setLevel(logging.ERROR)
        self._fiber: Any = build_fiber(
            FiberModel.MRG_INTERPOLATION,
            diameter=diameter_um,
            n_nodes=nodes or (61 if end == "through" else 31),
            passive_end_nodes=False,
        )
        along = np.asarray(self._fiber.longitudinal_coordinates) / 1000
        self.internode_mm = float(self._fiber.delta_z) / 1000
        self.along_mm: Array = along - (along.mean() if end == "through" else along[0])
        """Distance of each section from the ending or from the middle, (S,) mm."""

    def thresholds_ma(self, potential_mv_per_ma: Array, width_us: float, near_ma: Array) -> Array:
        """Return the threshold of each case, (C,) mA; NaN if there is none. The search begins near
        the estimates ``near_ma``, (C,). Potentials, (C, S), are those at the places `along_mm`.
        """
        from pyfibers import ScaledStim

        def pulse(time_ms: float) -> float:
            return 1.0 if time_ms < width_us / 1000 else 0.0

        stimulus: Any = ScaledStim(
            waveform=pulse, dt=_STEP_MS, tstop=_STOP_MS + width_us / 1000, pad_waveform=True
        )

        def fires(current_ma: float) -> bool:
            found = stimulus.run_sim(current_ma, self._fiber, fail_on_end_excitation=None)
            return bool(found[0])

        thresholds = []
        for field, near in zip(potential_mv_per_ma, near_ma, strict=True):
            self._fiber.potentials = field
            current = _START * near
            while fires(current):
                current /= 2
            while current < _MOST * near and not fires(current := current * _RUNG):
                pass
            low, high = current / _RUNG, current
            while high / low > 1 + _PRECISION:
                middle = float(np.sqrt(low * high))
                low, high = (low, middle) if fires(middle) else (middle, high)
            thresholds.append(high if current < _MOST * near else np.nan)
        return np.array(thresholds)
