"""Type checkers find each misspelled name of a program, and nothing in programs that are right."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from .whole import sample

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


@pytest.mark.parametrize("checker", sample(CHECKERS), ids=lambda each: each[0])
def test_misspellings_are_all_that_is_found(checker):
    """In one run: a checker reads the package each time."""
    if importlib.util.find_spec(checker[0]) is None:
        pytest.skip(f"{checker[0]} is not installed")
    if checker[0] == "pyright" and shutil.which("node") is None:
        pytest.skip("pyright would load a Node.js of its own")
    done = subprocess.run(
        [sys.executable, "-m", *checker, *map(str, [PROGRAM, *RIGHT])],
        capture_output=True, text=True, timeout=500, check=False, cwd=PROGRAM.parents[1],
        env=os.environ | {"PYRIGHT_PYTHON_GLOBAL_NODE": "1"},
    )  # fmt: skip
    assert len(WRONG) >= 17
    found = re.findall(r"(\w+)\.py:(\d+):.*error", done.stdout)
    assert {(name, int(line)) for name, line in found} == {("misspelled", each) for each in WRONG}
    # Which it says of how many it has read.
    if checker[0] == "mypy":
        assert f"checked {1 + len(RIGHT)} source files" in done.stdout
