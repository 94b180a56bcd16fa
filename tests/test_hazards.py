"""Tests that each hazard in docs/safety/hazards.md has a cause, a control and existing tests."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
HAZARDS = (ROOT / "docs/safety/hazards.md").read_text("utf-8")
NAMED = sorted(set(re.findall(r"`((?:firmware/)?tests/[\w/]+\.py::\w+)`", HAZARDS)))


def test_each_hazard_has_a_cause_a_control_and_a_test():
    lines = [line for line in HAZARDS.splitlines() if line.startswith("| ")][1:]
    assert len(lines) > 30
    for line in lines:
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        assert len(cells) == 4, line
        assert all(cells), line
        assert "tests/" in cells[3], line


@pytest.mark.parametrize("name", NAMED)
def test_a_test_that_is_named_is_one(name):
    file, _, test = name.partition("::")
    module = ast.parse((ROOT / file).read_text("utf-8"))
    assert (Path(file).name[:5], test[:4].lower()) == ("test_", "test")
    assert test in [each.name for each in module.body if hasattr(each, "name")]
