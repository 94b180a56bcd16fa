"""Type checkers find each misspelled name, setting and attribute of a program."""

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


@pytest.mark.parametrize("checker", [("mypy", "--strict"), ("pyright",)], ids=lambda each: each[0])
def test_twenty_misspellings_are_found(checker):
    if importlib.util.find_spec(checker[0]) is None:
        pytest.skip(f"{checker[0]} is not installed")
    if checker[0] == "pyright" and shutil.which("node") is None:
        pytest.skip("pyright would load a Node.js of its own")
    done = subprocess.run(
        [sys.executable, "-m", *checker, str(PROGRAM)],
        capture_output=True, text=True, timeout=500, check=False, cwd=PROGRAM.parents[1],
        env=os.environ | {"PYRIGHT_PYTHON_GLOBAL_NODE": "1"},
    )  # fmt: skip
    found = re.findall(r"misspelled\.py:(\d+):.*error", done.stdout)
    assert len(WRONG) >= 20
    assert {int(each) for each in found} == WRONG, done.stdout
