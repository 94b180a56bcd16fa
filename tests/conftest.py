"""Fixtures for all tests, and the folders from which tests import what they share."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))  # last: an installed package comes first
pytest_plugins = ["tests.fixtures"]
