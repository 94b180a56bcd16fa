"""Tests of ``smarttouch design`` and ``smarttouch profiles``, with shipped and own profiles."""

import json

import numpy as np
import pytest
from PIL import Image

from smarttouch.base.files import data_folder
from smarttouch.profile import list_profiles, load_profile
from smarttouch.profile.toml_files import as_toml, profile_path

from ..support.full import sample
from .conftest import refused

KEYS = {
    "mode", "site", "weights", "worst_other", "worst_other_class", "own_spill", "sum",
    "total_current", "activated_node", "kind", "optimal", "gap", "seconds",
}  # fmt: skip


@pytest.fixture
def designed(program_here, tmp_path):
    """Return a function that runs ``design`` and returns its output and its table of kernels."""

    def run(*arguments):
        done = program_here("design --json=k.json", *arguments).fine()
        table = done.figures
        for kernel in table["kernels"]:
            assert kernel.keys() >= KEYS
            assert abs(kernel["sum"]) < 1e-9
            assert kernel["total_current"] == pytest.approx(np.abs(kernel["weights"]).sum())
            assert kernel["optimal"] == (kernel["gap"] == 0)
        return done.stdout, table

    return run


def test_one_site_of_the_paper(designed):
    _, table = designed("--profile=line-7", "--mode=sai", "3")
    assert table["profile"] == "line-7"
    (kernel,) = table["kernels"]
    assert kernel["mode"] == "SAI"
    assert kernel["worst_other"] == pytest.approx(1.03 * 0.3025, abs=5e-5)
    assert kernel["worst_other_class"] == "RA"
    assert kernel["activated_node"] == 0
    assert np.argmax(np.abs(kernel["weights"])) == 3


@pytest.mark.parametrize("asked", sample(["smarttouch-4x4 --mode=RA", "kajimoto-61", "line-7"], 3))
def test_a_site_is_drawn(program_here, tmp_path, asked):
    program_here(f"design --profile={asked} 5 --plot=k.png").fine()
    with Image.open(tmp_path / "k.png") as picture:
        assert min(picture.size) > 400
        assert len(picture.getcolors(1 << 20)) > 50


FREE = """title = "Mine"
[array]
layout = "free"
positions_mm = [[0, 0], [1.8, 0], [0.9, 1.6], [2.7, 1.6], [4.2, 0.4]]
shape = "annulus"
size_mm = [1.0, 0.5]
[skin]
medium = "half-space"
conductivity_s_per_m = 0.43
ra_depth_mm = 0.7
sai_depth_mm = 0.9
pc_depth_mm = 2.0
sai_angles_deg = [0.0, 90.0]
node_spacing_mm = 0.25
"""


def test_an_array_and_a_skin_of_one_s_own(designed, tmp_path):
    shipped = (data_folder("calibration") / "electric-mouse.toml").read_text(encoding="utf-8")
    rest = shipped[shipped.index("[output]") :]
    (tmp_path / "mine.toml").write_text(FREE + rest, encoding="utf-8")
    _, table = designed("--profile=mine.toml", "--mode=SAI")
    assert {kernel["site"] for kernel in table["kernels"]} == set(range(5))
    assert all(0 < kernel["worst_other"] < 1 for kernel in table["kernels"])


def test_all_are_listed(program_here):
    done = program_here("profiles").fine()
    for name in list_profiles():
        assert name in done.stdout
    assert "electric-mouse (default)" in done.stdout


def test_a_copy_is_the_file_with_its_comments(program_here, tmp_path):
    assert program_here("profiles new mine.toml --like line-7").returncode == 0
    assert (tmp_path / "mine.toml").read_bytes() == profile_path("line-7").read_bytes()
    error = refused(program_here("profiles new mine.toml --like line-8"))
    assert "mine.toml" in str(error)
    assert "--overwrite" in str(error)
    assert (tmp_path / "mine.toml").read_bytes() == profile_path("line-7").read_bytes()
    assert program_here("profiles new mine.toml --like line-8 --overwrite").returncode == 0
    assert (tmp_path / "mine.toml").read_bytes() == profile_path("line-8").read_bytes()


def test_a_table_becomes_a_profile(program_here, tmp_path):
    table = tmp_path / "mine.csv"
    table.write_text("x_mm,y_mm,diameter_mm\n0,0,1\n2,0.1,1.1\n4,0,1.2\n", encoding="utf-8")
    program_here("profiles new mine.csv mine.toml").flawless()
    made = load_profile(tmp_path / "mine.toml")
    expected = load_profile("electric-mouse").with_electrodes(table, made.title)
    assert as_toml(made) == as_toml(expected)
    assert "--overwrite" in str(refused(program_here("profiles new mine.csv mine.toml")))


def test_a_grid_has_its_size_everywhere_and_shows_the_same_page(program_here, tmp_path):
    program_here("profiles new --grid 5x5 --pitch 2 five.toml").fine()
    made, mouse = load_profile(tmp_path / "five.toml"), load_profile("electric-mouse")
    assert made.array.rows == made.array.columns == 5
    assert "5 x 5" in made.title
    assert "8 x 8" not in (tmp_path / "five.toml").read_text("utf-8")
    assert made.optics.field_width_mm == mouse.optics.field_width_mm
    assert made.optics.magnification == pytest.approx(10 / 5)


@pytest.mark.parametrize("name", ["electric-mouse", "kajimoto-61"])
def test_what_is_shown_is_a_profile(program_here, tmp_path, name):
    done = program_here("profiles show", name).fine()
    assert done.stdout == as_toml(load_profile(name))
    (tmp_path / f"{name}.toml").write_text(done.stdout)
    assert load_profile(tmp_path / f"{name}.toml") == load_profile(name)


def with_defaults(path, **keys):
    text = profile_path("smarttouch-4x4").read_text("utf-8")
    lines = [f"{key} = {json.dumps(value)}" for key, value in keys.items()]
    path.write_text("\n".join([text, "[defaults]", *lines]), encoding="utf-8")


def test_board_form_and_plain_lines_come_from_the_profile(program_here, tmp_path):
    with_defaults(tmp_path / "mine.toml", board="memory:", plain=True, read_as="braille")
    read = ("read", "text:a", "--profile", "mine.toml")
    other = ("--board", "simulated:", "--set", "paced=no", "--as", "shapes")
    kept, given = program_here(*read), program_here(*read, *other)
    assert (kept.returncode, given.returncode) == (0, 0), given.stderr
    assert kept.stdout.splitlines()[0].endswith(", memory:")
    assert given.stdout.splitlines()[0].endswith(", simulated:")
    for done in (kept, given):
        assert "line 1 of 1: a\n" in done.stdout
        assert "1 line read: a\n" in done.stdout


def test_all_that_is_wrong_stands_in_a_line_of_its_own(program_here, tmp_path):
    text = profile_path("line-7").read_text(encoding="utf-8")
    wrong = text.replace("count = 7", "count = 1").replace("duty = 0.8", "duty = 8")
    (tmp_path / "mine.toml").write_text(wrong)
    done = program_here("profiles show mine.toml")
    assert done.returncode == 2
    lines = done.stderr.splitlines()
    assert len(lines) == 2
    assert all("mine.toml" in line for line in lines)
    assert "array.count" in lines[0]
    assert "limits.duty" in lines[1]


@pytest.mark.parametrize("arguments", [
    ("show", "nobody"), ("new", "mine.toml", "--like", "nobody"), ("new", "mine.txt"),
    ("new", "none/mine.toml"), ("new", "table.csv", "mine.toml", "--grid", "2x2"),
    ("new", "--grid", "5x", "a.toml"), ("new", "--grid", "5x5", "--pitch", "1", "a.toml"),
    ("new", "--grid", "99x2", "a.toml"),
])  # fmt: skip
def test_what_cannot_be_is_one_sentence(program_here, tmp_path, arguments):
    refused(program_here("profiles", *arguments))
    assert list(tmp_path.iterdir()) == []
