"""``live --set balance``: by recharge phases where a board makes them, else by reversing scans."""

import numpy as np
import pytest

from smarttouch.base.errors import BoardError
from smarttouch.emulator.firmware import read_slots

from ..boards.fresh import fresh_state
from .conftest import refused, says

pytestmark = pytest.mark.usefixtures("patient_boards")


@pytest.fixture
def live(program_here):
    """Return a runner of ``live`` over a short word."""
    touch = "live text:touch?speed_mm_s=80 --json run.json --intensity 1"
    return lambda options: program_here(f"{touch} {options}")


@pytest.mark.parametrize("mode", ["RA", "natural"])
def test_by_the_hosts_books_charge_is_back(live, mode):
    options = f"--board memory: --mode {mode}"
    plain = live(options).figures
    balanced = live(f"{options} --set balance").flawless().figures
    assert plain["max_net_charge_uc"] > 10 * balanced["max_net_charge_uc"] > 0


def test_where_it_does_not_fit_the_rate_falls_with_a_note(live, program_here):
    hurried = "--board simulated: --set rate_hz=150 --set scan=points --set balance"
    done = live(f"{hurried} --record run.mcap").fine()
    figures = done.figures
    assert figures["slowed_sequences"] > 0
    assert figures["lowest_rate_hz"] < figures["rate_hz"] < 150
    assert figures["emulator_violations"] == 0
    assert f"({figures['slowed_sequences']} sequences " in done.stdout
    program_here("replay run.mcap --check").fine()


def test_it_goes_together_with_holding_energy(live):
    figures = (
        live("--board simulated: --set scan=points --set hold=energy --set balance").fine().figures
    )
    assert (figures["emulator_violations"], figures["refused"]) == (0, 0)


def test_a_board_on_a_line_makes_them(live, start_emulator):
    _, port, books = start_emulator(64, "link")
    # Within the word: what the limits leave of one scan is taken back by the next.
    options = f"--board link:{port} --force fixed:1 --set balance --seconds 0.8"
    figures = live(options).fine().figures
    assert figures["emulator_violations"] == 0
    state = fresh_state(books)
    assert state["recharges"] == len(read_slots(books, recharges=True)) > 0
    assert (state["unsafe"], state["violations"]) == (0, 0)
    assert np.abs(state["passed_uc"]).max() < 0.02


def test_one_source_reverses_with_a_note_on_the_effect(live):
    done = live("--board simulated: --profile smarttouch-4x4 --set balance").fine()
    figures = done.figures
    for said in (done.stderr, done.stdout):
        assert all(name in said for name in ("RA", "SAI"))
    assert "SAI where RA is meant" in done.stderr
    assert figures["emulator_violations"] == 0
    assert figures["slots"] > 20


def test_so_does_an_etactilekit(live, start_emulator):
    _, port, books = start_emulator(32, "etactilekit")
    done = live(f"--board etactilekit:{port} --force fixed:1 --set balance --seconds 0.8").fine()
    assert "SAI where RA is meant" in done.stderr
    assert fresh_state(books)["recharges"] == 0


def test_a_board_of_one_polarity_refuses(live, start_emulator):
    _, port, _ = start_emulator(61, "kajimoto61")
    done = live(f"--board kajimoto61:{port} --force fixed:1 --set balance")
    says(BoardError, value=("anodic",))(refused(done))
