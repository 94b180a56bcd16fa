"""``live --balance``: by recharge phases where a board makes them, else by reversing scans."""

import json

import numpy as np
import pytest

from smarttouch.boards.emulator.delivery_log import read_recharges
from smarttouch.errors import BoardError

from ..boards.fresh import fresh_state
from .conftest import refused, says


@pytest.fixture
def live(program_here, tmp_path):
    """Return a runner of ``live`` over a short word: how it ended, and its figures."""

    def run(*options):
        done = program_here(
            "live", "--source", "text:touch", "--json", "run.json", "--intensity", 1, *options
        )
        path = tmp_path / "run.json"
        figures = json.loads(path.read_text()) if done.returncode == 0 else {}
        return done, figures

    return run


@pytest.mark.parametrize("mode", ["RA", "SAI", "PC", "natural"])
def test_by_the_hosts_books_charge_is_back(live, mode):
    options = ("--board", "memory:", "--mode", mode, "--quiet")
    _, plain = live(*options)
    done, balanced = live(*options, "--balance")
    assert (done.returncode, done.stderr) == (0, "")
    assert plain["max_net_charge_uc"] > 10 * balanced["max_net_charge_uc"] > 0


def test_where_it_does_not_fit_the_rate_falls_and_the_run_says_so(live):
    done, figures = live("--board", "simulated:", "--rate", 150, "--scan", "points", "--balance")
    assert done.returncode == 0, done.stderr
    assert figures["slowed_sequences"] > 0
    assert figures["lowest_rate_hz"] < figures["rate_hz"] < 150
    assert figures["emulator_violations"] == 0
    assert f"({figures['slowed_sequences']} sequences " in done.stdout


def test_it_goes_together_with_holding_energy(live):
    done, figures = live(
        "--board", "emulator:", "--scan", "points", "--hold", "energy", "--balance"
    )
    assert done.returncode == 0, done.stderr
    assert (figures["emulator_violations"], figures["refused"]) == (0, 0)


def test_a_board_on_a_line_makes_them(live, start_emulator):
    _, port, books = start_emulator(64, "link")
    done, figures = live("--board", f"link:{port}", "--force", "fixed:1", "--balance")
    assert done.returncode == 0, done.stderr
    assert figures["emulator_violations"] == 0
    state = fresh_state(books)
    assert state["recharges"] == len(read_recharges(books)) > 0
    assert (state["unsafe"], state["violations"]) == (0, 0)
    assert np.abs(state["passed_uc"]).max() < 0.02


def test_one_source_reverses_and_says_what_that_does(live):
    done, figures = live("--board", "simulated:", "--profile", "smarttouch-4x4", "--balance")
    assert done.returncode == 0, done.stderr
    for said in (done.stderr, done.stdout):
        assert all(name in said for name in ("RA", "SAI"))
    assert "SAI where RA is meant" in done.stderr
    assert figures["emulator_violations"] == 0
    assert figures["slots"] > 20


def test_so_does_an_etactilekit(live, start_emulator):
    _, port, books = start_emulator(32, "etactilekit")
    done, _ = live("--board", f"etactilekit:{port}", "--force", "fixed:1", "--balance")
    assert done.returncode == 0, done.stderr
    assert "SAI where RA is meant" in done.stderr
    assert fresh_state(books)["recharges"] == 0


def test_a_board_of_one_polarity_refuses(live, start_emulator):
    _, port, _ = start_emulator(61, "kajimoto61")
    done, _ = live("--board", f"kajimoto61:{port}", "--force", "fixed:1", "--balance")
    wrong = refused(done)
    says(BoardError, about="balance", value=("anodic",))(wrong)


def test_it_is_recorded_and_checked(live, program_here):
    done, _ = live("--board", "simulated:", "--balance", "--record", "run.mcap", "--quiet")
    assert done.returncode == 0, done.stderr
    checked = program_here("replay", "run.mcap", "--check")
    assert checked.returncode == 0, checked.stdout


def test_what_is_felt_shows_no_recharge(live, tmp_path):
    pictures = []
    felt = ("--board", "simulated:", "--felt", "felt.png", "--anatomy", "paper", "--quiet")
    for balance in ((), ("--balance",)):
        done, _ = live(*felt, *balance)
        assert done.returncode == 0, done.stderr
        pictures.append((tmp_path / "felt.png").read_bytes())
    assert pictures[0] == pictures[1]
