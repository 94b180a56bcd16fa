"""Type checkers find each misspelled name of a program, and nothing in programs that are right."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).with_name("misspelled.py")
LINES = PROGRAM.read_text("utf-8").splitlines()
WRONG = {number for number, line in enumerate(LINES, 1) if line.endswith("# wrong")}


EXAMPLES = PROGRAM.parents[1] / "examples"
RIGHT = [
    EXAMPLES / f"{name}.py"
    for name in ("analyze_recording", "irregular_array", "own_board", "own_feed", "own_imaging",
                 "own_stimulus", "show_patterns", "two_intervals")
]  # fmt: skip
CHECKERS = [("mypy", "--strict"), ("pyright", "--pythonpath", sys.executable)]


def checked(checker, *programs):
    """Return what a type checker prints of programs."""
    if importlib.util.find_spec(checker[0]) is None:
        pytest.skip(f"{checker[0]} is not installed")
    if checker[0] == "pyright" and shutil.which("node") is None:
        pytest.skip("pyright would load a Node.js of its own")
    done = subprocess.run(
        [sys.executable, "-m", *checker, *map(str, programs)],
        capture_output=True, text=True, timeout=500, check=False, cwd=PROGRAM.parents[1],
        env=os.environ | {"PYRIGHT_PYTHON_GLOBAL_NODE": "1"},
    )  # fmt: skip
    return done.stdout


@pytest.mark.parametrize("checker", CHECKERS, ids=lambda each: each[0])
def test_twenty_misspellings_are_found(checker):
    printed = checked(checker, PROGRAM)
    assert len(WRONG) >= 20
    found = re.findall(r"misspelled\.py:(\d+):.*error", printed)
    assert {int(each) for each in found} == WRONG, printed


@pytest.mark.parametrize("checker", CHECKERS, ids=lambda each: each[0])
def test_nothing_is_found_in_programs_that_are_right(checker):
    printed = checked(checker, *RIGHT)
    assert "error:" not in printed
    assert re.search(r"no issues found|^0 errors", printed, re.MULTILINE), printed
