"""The scripts of examples/ run as they stand, each in a process of its own, and show every name."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import smarttouch as st

EXAMPLES = Path(__file__).parent.parent / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_it_runs(path, tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "error", path],
        cwd=tmp_path,
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache"), "MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout
    assert {each.name for each in tmp_path.iterdir()} <= {"cache"}


def test_every_public_name_is_in_one():
    shown = "\n".join(path.read_text("utf-8") for path in SCRIPTS)
    names = [name for name in st.__all__ if not name.startswith("_")]
    assert [name for name in names if not re.search(rf"\bst\.{name}\b", shown)] == []
