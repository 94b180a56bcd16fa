"""From a page to the emulator's books; the sample page through the installed program."""

import base64
import json

import numpy as np
import pytest
from mcap.reader import make_reader
from PIL import Image
from skimage import data

from smarttouch.base.files import data_folder
from smarttouch.profile import list_profiles, load_profile

from ..whole import sample
from .conftest import panels

pytestmark = pytest.mark.usefixtures("patient_boards")

SAMPLE = f"page:{data_folder('sample_images') / 'page.png'}"
KEYS = {
    "frames", "sequences", "slots", "pulses", "acknowledged", "dropped_frames", "rate_asked_hz",
    "rate_hz", "latency_us", "max_current_ma", "max_charge_uc", "max_net_charge_uc",
    "emulator_violations", "active_fraction",
}  # fmt: skip


def messages(path, topic):
    with path.open("rb") as file:
        return [
            json.loads(message.data)
            for _, _, message in make_reader(file).iter_messages(topics=[topic])
        ]


def packed(message, key, kind):
    return np.frombuffer(base64.b64decode(message[key]), kind)


def assert_safe(figures, current_ma=5.0, charge_uc=0.5):
    # On a machine that lets us starve for 0.1 s the board drops what it has, and is started anew.
    assert 0 < figures["frames"] == figures["sequences"]
    assert figures["sequences"] - figures["acknowledged"] <= figures["restarts"] <= 2
    assert figures["refused"] <= figures["restarts"]
    assert figures["emulator_violations"] == 0
    assert 0 < figures["max_current_ma"] <= current_ma
    assert 0 < figures["max_charge_uc"] <= charge_uc
    assert figures["max_net_charge_uc"] < 1e-3


def ink_agreement(page, touch):
    """Correlation of two panels of a felt picture."""
    best = 0.0
    for shift in range(-12, 13):
        moved = np.roll(touch, shift, axis=0)
        best = max(best, float(np.corrcoef(page.ravel(), moved.ravel())[0, 1]))
    return best


def test_the_sample_page(program, tmp_path):
    done = program(
        "live", f"{SAMPLE}?speed_mm_s=120", "--felt", "felt.png", "--set", "finger=paper",
        "--json", "run.json", "--record", "run.mcap", real=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    figures = json.loads((tmp_path / "run.json").read_text())
    assert set(figures) >= KEYS
    assert figures["ended"] == "end of the page"
    assert set(figures["latency_us"]) == {"p50", "p99", "max"}
    assert_safe(figures)
    page, delivered, felt = panels(tmp_path / "felt.png", 3)
    # On a busy machine a part is not delivered; in simulated time, below, more is asked for.
    assert ink_agreement(page, delivered) > 0.2
    assert ink_agreement(page, felt) > 0.2
    sequences = messages(tmp_path / "run.mcap", "/step")
    # A busy machine may be late: what is dropped then is recorded too, without a number.
    sent = [sequence for sequence in sequences if sequence["sent"]]
    assert len(sent) == figures["frames"]
    assert len(sequences) == len(sent) + figures["dropped_late"] + figures["restarts"]
    assert sum(sequence["slots"] for sequence in sent) == figures["slots"]
    assert len(messages(tmp_path / "run.mcap", "/frame")) == len(sequences)


def test_a_photographed_page(program_here, tmp_path):
    Image.fromarray(data.page()).save(tmp_path / "page.png")
    page = "page:page.png?page_width_mm=110&speed_mm_s=300"
    live = f"live --set paced=no {page} --seconds 3 --json run.json"
    done = program_here(live).flawless()
    assert_safe(done.figures)
    assert 0.1 < done.figures["active_fraction"] < 0.5


@pytest.mark.parametrize("name", sample(list_profiles(), 4))
def test_every_profile_runs(figures_of, tmp_path, name):
    # Axons that branch take seconds beneath a large array.
    anatomy = "branched" if len(load_profile(name).electrodes) <= 32 else "paper"
    # The first letters open the level, with their pulses.
    live = "live --set paced=no 'text:the the the the?speed_mm_s=30'"
    assert_safe(figures_of(f"{live} --profile={name} --felt=felt.png --set finger={anatomy}"))
    # Arrays that show no shapes.
    if name.startswith(("line", "concentric")):
        assert (tmp_path / "felt.png").stat().st_size > 1000
        return
    page, delivered, felt = panels(tmp_path / "felt.png", 3)
    # Measured: .58 and .53 at least.
    assert ink_agreement(page, delivered) > 0.5
    assert ink_agreement(page, felt) > 0.4


def test_sai_and_light_on_dark(figures_of):
    page = data_folder("sample_images") / "light_on_dark.png"
    options = "--set paced=no --mode=sai --set light_on_dark --seconds=2"
    assert_safe(figures_of(f"live page:{page}?speed_mm_s=500 {options}"))


def recorded(program_here, tmp_path, name, seed):
    same = "live --set paced=no text:same?speed_mm_s=200"
    program_here(f"{same} --set seed={seed} --record={name}").fine()
    sequences = messages(tmp_path / name, "/step")
    return [
        (entry["site"], entry["period_us"], base64.b64decode(entry["current_ua"]))
        for entry in sequences
    ]


def test_same_seed_same_sequences(program_here, tmp_path):
    first = recorded(program_here, tmp_path, "a.mcap", 5)
    assert first == recorded(program_here, tmp_path, "b.mcap", 5)
    assert first != recorded(program_here, tmp_path, "c.mcap", 6)


def along(folder, rows):
    """Return a command over the sample page along a recorded path."""
    (folder / "p.csv").write_text("time_s,x_mm,y_mm,angle_deg,force_n\n" + rows)
    return f"live --set paced=no {SAMPLE}?path=p.csv"


def test_recorded_path(figures_of, tmp_path):
    path = along(tmp_path, "0,5,11,0,0\n0.1,5,11,0,1\n1,40,11,0,1\n")
    figures = figures_of(f"{path} --record run.mcap")
    finger = messages(tmp_path / "run.mcap", "/step")
    assert (finger[0]["x_mm"], finger[0]["force_n"]) == (5, 0)
    assert figures["slots"] > 0


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
