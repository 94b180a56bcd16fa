"""`smarttouch simulate study`: tables, pictures, and what it refuses."""

import joblib
import pytest
from PIL import Image

from smarttouch.base.errors import ProfileError
from smarttouch.cli.simulate import study

from ..raising import assert_says
from .conftest import refused

PLAN = (
    'title = "x"\nprofiles = ["smarttouch-4x4"]\nanatomies = ["paper"]\nfingers = 1\nletters = "L"'
)


@pytest.fixture
def plan(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


def test_a_table_and_a_plot(plan, tmp_path, capsys):
    with joblib.parallel_config("threading", n_jobs=1):
        study(plan, tmp_path / "out")
    assert len((tmp_path / "out" / "rows.csv").read_text().splitlines()) == 2
    with Image.open(tmp_path / "out" / "study.png") as picture:
        assert min(picture.size) > 200
    assert str(tmp_path / "out" / "rows.csv") in capsys.readouterr().out


def test_it_ends_with_one_sentence(program_here, tmp_path):
    (tmp_path / "plan.toml").write_text("fingers = 3")
    error = refused(program_here("simulate study plan.toml --output out"))
    assert type(error) is ProfileError
    assert_says(error, key="title")
    (tmp_path / "plan.toml").write_text(PLAN)
    error = refused(program_here("simulate study plan.toml --output out --cluster nowhere:x"))
    assert_says(error)
