"""Tests of ``smarttouch live``: from a page to the delivery log of an emulated board."""

import base64
import json
import os
import pty
import subprocess
import time

import numpy as np
import pytest
from mcap.reader import make_reader

from smarttouch.base.files import data_folder
from smarttouch.emulator.firmware_base import read_slots
from smarttouch.profile import list_profiles, load_profile

from ..boards.emulator_waits import fresh_state
from ..support.full import sample
from ..support.processes import PROGRAM, Forked
from .conftest import panels

SAMPLE = f"page:{data_folder('sample_images') / 'page.png'}"


def messages(path, topic):
    with path.open("rb") as file:
        return [
            json.loads(message.data)
            for _, _, message in make_reader(file).iter_messages(topics=[topic])
        ]


def packed(message, key, kind):
    return np.frombuffer(base64.b64decode(message[key]), kind)


def assert_safe(figures, current_ma=5.0, charge_uc=0.5):
    # If a busy computer delays the host by 0.1 s, the board drops its sequences and restarts.
    assert 0 < figures["frames"] == figures["sequences"]
    assert figures["sequences"] - figures["acknowledged"] <= figures["restarts"] <= 2
    assert figures["refused"] <= figures["restarts"]
    assert figures["emulator_violations"] == 0
    assert 0 < figures["max_current_ma"] <= current_ma
    assert 0 < figures["max_charge_uc"] <= charge_uc
    assert figures["max_net_charge_uc"] < 1e-3


def ink_agreement(page, touch):
    """Return the largest correlation of two panels of a ``--felt`` picture, over small shifts."""
    best = 0.0
    for shift in range(-12, 13):
        moved = np.roll(touch, shift, axis=0)
        best = max(best, float(np.corrcoef(page.ravel(), moved.ravel())[0, 1]))
    return best


def test_the_sample_page(program, tmp_path):
    done = program(
        "live", f"{SAMPLE}?speed_mm_s=120", "--felt", "felt.png", "--set", "finger=paper",
        "--json", "run.json", "--record", "run.mcap",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    figures = json.loads((tmp_path / "run.json").read_text())
    assert figures["ended"] == "end of the page"
    assert set(figures["latency_us"]) == {"p50", "p99", "max"}
    assert_safe(figures)
    page, delivered, felt = panels(tmp_path / "felt.png", 3)
    # A busy computer can drop sequences. Tests in simulated time require higher correlations.
    assert ink_agreement(page, delivered) > 0.2
    assert ink_agreement(page, felt) > 0.2
    sequences = messages(tmp_path / "run.mcap", "/step")
    # Sequences that are dropped because the computer is late are recorded too, but not as sent.
    sent = [sequence for sequence in sequences if sequence["sent"]]
    assert len(sent) == figures["frames"]
    assert len(sequences) == len(sent) + figures["dropped_late"] + figures["restarts"]
    assert sum(sequence["slots"] for sequence in sent) == figures["slots"]
    assert len(messages(tmp_path / "run.mcap", "/frame")) == len(sequences)


@pytest.mark.parametrize("name", sample(list_profiles(), 5))
def test_every_profile_runs(figures_of, tmp_path, name):
    # With a large array, the simulation of the branched axons below it takes seconds.
    anatomy = "branched" if len(load_profile(name).electrodes) <= 32 else "paper"
    # The first words complete the ramp, which rises only while pulses flow.
    live = "live --set paced=no 'text:the the the the?speed_mm_s=30'"
    assert_safe(figures_of(f"{live} --profile={name} --felt=felt.png --set finger={anatomy}"))
    # These arrays cannot show letters, so do not compare panels.
    if name.startswith(("line", "concentric")):
        assert (tmp_path / "felt.png").stat().st_size > 1000
        return
    page, delivered, felt = panels(tmp_path / "felt.png", 3)
    # Over all profiles, the smallest correlations are .58 for `delivered` and .53 for `felt`.
    assert ink_agreement(page, delivered) > 0.5
    assert ink_agreement(page, felt) > 0.4


def test_many_points_in_a_slot(program_here, tmp_path):
    page = "live text:on?speed_mm_s=100 --set paced=no --json f.json"
    done = program_here(f"{page} --set scan=points --record points.mcap").fine()
    points, done = done.figures, program_here(f"{page} --record auto.mcap").fine()
    frames = done.figures
    assert_safe(frames)
    assert 2.5 * frames["slots"] < points["slots"]
    assert 0 < points["worst_other"] < frames["worst_other"] <= 0.3
    assert 0 < frames["worst_spill"] <= 0.3
    assert f" {frames['worst_other']:.0%} " in done.stdout
    assert f" {frames['worst_spill']:.0%} " in done.stdout
    proved = [each for each in messages(tmp_path / "auto.mcap", "/step") if each["slots"]]
    shared = [
        other
        for each in proved
        for other, count in zip(
            packed(each, "worst_other", "<f4"), packed(each, "points", "<u2"), strict=False
        )
        if count > 1
    ]
    assert max(shared) == pytest.approx(frames["worst_other"])
    assert messages(tmp_path / "points.mcap", "/step")[-1]["worst_other"] is None
    program_here("replay auto.mcap --check").fine()


def lasts(*options, seconds):
    """Return whether a run of a short text at a terminal still lasts after ``seconds``."""
    ours, terminal = pty.openpty()
    words = [PROGRAM, "live", "text:i?speed_mm_s=400", "--board", "simulated:", *options]
    with Forked(
        words, stdin=subprocess.DEVNULL, stdout=terminal, stderr=subprocess.PIPE, text=True
    ) as run:
        os.close(terminal)
        os.set_blocking(ours, False)
        until_s = time.monotonic() + seconds
        try:
            while run.poll() is None and time.monotonic() < until_s:
                time.sleep(0.05)
                try:
                    os.read(ours, 1 << 16)
                except OSError:
                    continue
            return run.poll() is None
        finally:
            run.terminate()
            run.wait(30)
            os.close(ours)


def test_on_a_screen_it_is_read_again(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    begun_s = time.monotonic()
    assert not lasts("--plain", seconds=60), "with --plain a text must be read only once"
    assert lasts(seconds=1 + 2 * (time.monotonic() - begun_s))


@pytest.fixture
def live(program_here):
    """Return a function that runs ``live`` over a short word."""
    touch = "live text:touch?speed_mm_s=80 --json run.json --intensity 1"
    return lambda options: program_here(f"{touch} {options}")


def test_where_it_does_not_fit_the_rate_falls_with_a_note(live, program_here):
    hurried = "--board simulated: --set paced=no --set rate_hz=150 --set scan=points --set balance"
    done = live(f"{hurried} --record run.mcap").fine()
    figures = done.figures
    assert figures["slowed_sequences"] > 0
    assert figures["lowest_rate_hz"] < figures["rate_hz"] < 150
    assert figures["emulator_violations"] == 0
    assert f"({figures['slowed_sequences']} sequences " in done.stdout
    program_here("replay run.mcap --check").fine()


@pytest.mark.realtime
def test_a_board_on_a_line_makes_them(live, start_emulator):
    _, port, books = start_emulator(64, "link")
    options = f"--board link:{port} --force fixed:1 --set balance --seconds 0.8"
    figures = live(options).fine().figures
    assert figures["emulator_violations"] == 0
    state = fresh_state(books)
    assert state["recharges"] == len(read_slots(books, recharges=True)) > 0
    assert (state["unsafe"], state["violations"]) == (0, 0)
    # Each scan balances its own net charge and that of earlier scans, so little is left at the end.
    assert np.abs(state["passed_uc"]).max() < 0.02
