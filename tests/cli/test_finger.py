"""`smarttouch finger`: figures, pictures, and what they refuse."""

import pytest
from PIL import Image

from smarttouch.errors import ExperimentError, ProfileError, SmartTouchError

from ..raising import assert_says
from .conftest import refused


def test_a_letter_on_one_finger(program_here, tmp_path):
    table = program_here(
        "finger", "IT", "--profile=smarttouch-4x4", "--anatomy=paper", "--fingers=2",
        "--json=felt.json", "--plot=felt.png",
    ).fine().figures  # fmt: skip
    assert (table["letters"], table["fingers"], table["anatomy"]) == ("IT", 2, "paper")
    for name in ("wrong_class", "misplaced", "silent_points", "at_board"):
        assert 0 <= table[name] <= 1
    assert set(table["fired"]) == {"RA", "SAI", "PC"}
    assert table["fired"]["RA"] > 0
    assert table["nociceptive"] > 0
    assert 0 <= table["at_nerve"]["median"] <= table["at_nerve"]["worst_tenth"] <= 1
    with Image.open(tmp_path / "felt.png") as picture:
        assert min(picture.size) > 400
        assert len(picture.getcolors(1 << 22)) > 50


@pytest.mark.parametrize(("name", "columns"), [("effects", 3), ("published", 4)])
def test_tables_of_what_was_published(program_here, tmp_path, name, columns):
    table = (
        program_here(
            "finger", "IT", f"--table={name}", "--anatomy=paper", "--fingers=1", "--json=t.json"
        )
        .fine()
        .figures
    )
    assert (table["anatomy"], table["fingers"]) == ("paper", 1)
    assert len(table[name]) >= 10
    assert {len(row) for row in table[name]} == {columns}
    assert all(row["fingers"] for row in table[name])


@pytest.mark.parametrize(("arguments", "kind", "says"), [
    ("4", ExperimentError, {"about": "LETTERS", "value": "4"}),
    ("T --anatomy=none", ProfileError, {"about": "anatomy", "value": "none"}),
    ("T --profile=line-7", ExperimentError, {"about": "profile", "value": 1}),
    ("--table=none", SmartTouchError, {"about": "table"}),
    ("T --mode=SAII", SmartTouchError, {"about": "mode"}),
])  # fmt: skip
def test_fingers_of_nonsense(program_here, arguments, kind, says):
    error = refused(program_here("finger", *arguments.split()))
    assert isinstance(error, kind)
    assert_says(error, **says)
