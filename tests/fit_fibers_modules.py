"""Access for tests to the modules of the program ``examples/fit_fibers``."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent.parent / "examples" / "fit_fibers"))

import fiber_fit

__all__ = ["fiber_fit"]
