"""Access for tests to the modules of the program ``examples/fit_fibers``."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent.parent / "examples" / "fit_fibers"))

import fiber_cases
import fiber_fit
import fit_fibers
import mrg

__all__ = ["fiber_cases", "fiber_fit", "fit_fibers", "mrg"]
