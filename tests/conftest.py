"""Configuration of pytest for all tests: import path and shared fixtures."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))  # at the end: an installed package has precedence
pytest_plugins = ["tests.fixtures"]
