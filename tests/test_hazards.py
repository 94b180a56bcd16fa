"""Each hazard and each promise of the safety page names tests that exist and are run."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGES = ROOT / "docs" / "explanation"
HAZARDS = (PAGES / "hazards.md").read_text("utf-8")
NAMED = sorted(set(re.findall(r"`(tests/[\w/]+\.py::\w+)`", HAZARDS)))
PROMISED = ("While it runs", "Definitions", "Ends in zero")
"""Sections of the safety page that promise something, point by point."""


def rows(heading):
    """Return the cells of each row of the table after a heading."""
    part = HAZARDS.partition(heading)[2].partition("\n## ")[0]
    lines = [line for line in part.splitlines() if line.startswith("|")][2:]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def test_each_hazard_has_a_cause_a_control_and_a_test():
    table = rows("The harm is in each case")
    assert len(table) > 20
    for row in table:
        assert len(row) == 5, row[0]
        assert all(row), row[0]
        assert "`tests/" in row[4], row[0]


def test_each_promise_names_a_test():
    safety = (PAGES / "safety.md").read_text("utf-8")
    kept = [name for name, tests in rows("## Promises") if "`tests/" in tests]
    for heading in PROMISED:
        section = safety.partition(f"## {heading}\n")[2].partition("\n## ")[0]
        points = re.findall(r"^- (\*\*)?(.*)$", section, re.MULTILINE)
        assert points
        for bold, words in points:
            assert bold, f"{words!r} has no name"
            assert [name for name in kept if words.startswith(name)], words


def test_the_tests_that_are_named_are_collected():
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-n0", *NAMED]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout[-2000:]
    collected = {line.partition("[")[0] for line in found.stdout.splitlines() if "::" in line}
    assert set(NAMED) <= collected
