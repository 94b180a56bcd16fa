"""Each hazard and each promise of the safety page names tests that exist and are run."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = ROOT / "docs" / "safety"
HAZARDS = (PAGES / "hazards.md").read_text("utf-8")
NAMED = sorted(set(re.findall(r"`((?:firmware/)?tests/[\w/]+\.py::\w+)`", HAZARDS)))
PROMISED = {"While it runs": "index.md", "Ends in zero": "index.md", "Definitions": "limits.md"}
"""Sections that promise something, point by point, and their pages."""


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
        assert "tests/" in row[4], row[0]


def test_each_promise_names_a_test():
    kept = [name for name, tests in rows("## Promises") if "tests/" in tests]
    for heading, page in PROMISED.items():
        section = (
            (PAGES / page).read_text("utf-8").partition(f"## {heading}\n")[2].partition("\n## ")[0]
        )
        points = re.findall(r"^- (\*\*)?(.*)$", section, re.MULTILINE)
        assert points
        for bold, words in points:
            assert bold, f"{words!r} has no name"
            assert [name for name in kept if words.startswith(name)], words


@pytest.mark.parametrize("name", NAMED)
def test_a_test_that_is_named_is_one(name):
    file, _, test = name.partition("::")
    module = ast.parse((ROOT / file).read_text("utf-8"))
    assert (Path(file).name[:5], test[:4].lower()) == ("test_", "test")
    assert test in [each.name for each in module.body if hasattr(each, "name")]
