"""Every ceiling stands in the documentation with its source."""

from pathlib import Path

import pytest

from smarttouch.profile.ceilings import CEILINGS

SAFETY = Path(__file__).parents[2] / "docs" / "safety" / "limits.md"


@pytest.mark.parametrize("ceiling", CEILINGS, ids=lambda each: each.name)
def test_the_documentation_has_it_with_its_source(ceiling):
    value = f"{ceiling.value:g} {ceiling.unit}".strip()
    assert f"| {ceiling.name} | {value} | {ceiling.source} |" in SAFETY.read_text(encoding="utf-8")
