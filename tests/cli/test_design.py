"""``design`` shows what is shipped, and what a user describes."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError, SmartTouchError
from smarttouch.base.files import data_folder

from ..whole import sample
from .conftest import refused, says

KEYS = {
    "mode", "site", "weights", "worst_other", "worst_other_class", "own_spill", "sum",
    "total_current", "activated_node", "kind", "optimal", "gap", "seconds",
}  # fmt: skip


@pytest.fixture
def designed(program_here, tmp_path):
    """Return a runner of ``design`` that gives what it printed and its kernels."""

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


def test_all_modes_of_all_sites(designed):
    printed, table = designed("--profile=line-7")
    assert "3.1308" in printed
    named = [(kernel["mode"], kernel["site"]) for kernel in table["kernels"]]
    assert named == [(mode.name, site) for mode in Afferent for site in range(7)]


def test_any_node(designed):
    _, anywhere = designed("--profile=line-7", "--any-node", "--mode=PC")
    first, last = (anywhere["kernels"][site] for site in (0, 6))
    assert first["worst_other"] == pytest.approx(last["worst_other"])
    assert first["weights"] == pytest.approx(last["weights"][::-1])


@pytest.mark.parametrize("asked", sample(["smarttouch-4x4 --mode=RA", "kajimoto-61", "line-7"]))
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


@pytest.mark.parametrize(("arguments", "wrong"), [
    ("7 --profile=line-7", says(value=7, allowed=(0, 6))),
    ("--mode=PA", says(value="PA", allowed=("RA", "SAI", "PC"))),
    ("--profile=kajimoto-61 --mode=SAI",
     says(DesignError, value="SAI", allowed=("RA",))),
    ("--plot=k.jpg --profile=line-7", says(SmartTouchError, "k.jpg", "*.png")),
    ("--plot=no/k.png", says(value=Path("no/k.png"))),
])  # fmt: skip
def test_nonsense_is_one_sentence(program_here, arguments, wrong):
    wrong(refused(program_here("design", *arguments.split())))
