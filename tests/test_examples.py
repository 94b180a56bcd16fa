"""Tests that the scripts in examples/ run, and that together they use every public name."""

import re
import runpy
import sys
from pathlib import Path

import pytest

import smarttouch as st

from .support.full import sample

EXAMPLES = Path(__file__).parent.parent / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
LONG = (
    "activating_function", "activating_function_error", "array_study", "braille_page",
    "electric_mouse", "frequency_discrimination", "irregular_array", "design_kernels",
    "own_experiment", "paper_effects", "read_a_page", "strength_duration",
)  # fmt: skip
"""Slow scripts, which run only when the gallery of the documentation is built."""


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """Return a cache folder for all scripts, so that kernels are designed only once."""
    return tmp_path_factory.mktemp("cache")


@pytest.mark.parametrize("path", sample(SCRIPTS, 8), ids=lambda path: path.stem)
def test_it_runs(path, cache, tmp_path, monkeypatch, capsys):
    if path.stem in LONG:
        pytest.skip("slow: runs when the documentation is built")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    monkeypatch.setenv("MPLBACKEND", "agg")
    runpy.run_path(str(path), run_name="__main__")
    if (pyplot := sys.modules.pop("matplotlib.pyplot", None)) is not None:
        # Close the figures, so that later tests do not see them.
        pyplot.close("all")
    assert capsys.readouterr().out
    assert [*tmp_path.iterdir()] == []


def test_every_public_name_is_in_one():
    shown = "\n".join(path.read_text("utf-8") for path in SCRIPTS)
    names = [name for name in st.__all__ if not name.startswith("_")]
    assert [name for name in names if not re.search(rf"\bst\.{name}\b", shown)] == []
