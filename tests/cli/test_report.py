"""A file for a bug report has what helps, and nothing of participants."""

import json
import re

import numpy as np
import pytest
from PIL import Image

import smarttouch as st
from smarttouch.base.errors import RecordingError
from smarttouch.emulator.link_firmware import NAME
from smarttouch.running.bug_report import _FIRMWARE, _kind, _version
from smarttouch.running.recording_reader import Recording
from smarttouch.sources.force import open_force

from .conftest import says


def record(path, words="Annabel", **settings):
    display = st.open_display("simulated:")
    source = st.open_source(f"text:{words}", display.profile)
    st.run(source, display, seconds=0.3, listeners=[st.Recorder(path)], **settings)


def report(program_here, tmp_path, *arguments):
    program_here("report", *arguments, "--output", tmp_path / "report.json").flawless()
    return (tmp_path / "report.json").read_text("utf-8")


def test_versions_and_drivers(program_here, tmp_path):
    told = json.loads(report(program_here, tmp_path))
    assert told["smarttouch"] == st.__version__
    assert {"numpy", "pyserial"} <= told["packages"].keys()
    assert "link" in told["drivers"]
    assert "run" not in told


def test_a_run_without_who_felt_it(program_here, tmp_path):
    record(tmp_path / "Carla.mcap", subject="Berta", note="left hand")
    text = report(program_here, tmp_path, tmp_path / "Carla.mcap")
    run = json.loads(text)["run"]
    assert run["settings"]["board"] == "simulated:"
    assert run["settings"]["sensor"] == "text:"
    assert run["firmware"] == NAME
    assert run["versions"]["smarttouch"] == st.__version__
    assert run["whole"]
    assert run["device"]["array"]["rows"] == 8
    for private in ("Berta", "left hand", "Annabel", "Carla", "threshold", "comfort"):
        assert private not in text


def test_nothing_that_is_not_in_the_list_goes_in(program_here, tmp_path, profile):
    """Names of files, whatever holds them, and what was measured on a person and delivered."""
    page, force = tmp_path / "Alice Liddell.png", tmp_path / "force of Alice.csv"
    stripes = np.where(np.arange(400) % 20 < 10, 0, 255).astype(np.uint8)
    Image.fromarray(np.tile(stripes, (300, 1))).save(page)
    force.write_text("time_s,force_n\n0,1\n60,1\n")
    changed = profile.model_dump()
    changed["perception"] |= {"threshold_ma": 0.713, "comfort_ma": None, "comfort_ratio": 1.37}
    changed["limits"] |= {"current_ma": 1.913, "electrode_ma": None}
    chosen = type(profile).model_validate(changed | {"title": "hand of Alice"})
    path = tmp_path / "run.mcap"
    with st.open_source(f"page:{page}?dpi=100", chosen) as source:
        st.run(
            source, st.open_display("simulated:", chosen), intensity=1.0, seconds=1.0,
            force=open_force(f"recorded:{force}", chosen), subject="Alice", note="0.713",
            listeners=[st.Recorder(path)],
        )  # fmt: skip
    words = " ".join(words for _, words in Recording(path).events())
    strongest = re.search(r"strongest (\S+) mA", words)[1]
    assert 0 < float(strongest) <= 0.713 * 1.37 + 1e-3
    text = report(program_here, tmp_path, path)
    names = ("Alice", "Liddell", "force of", "hand of", ".png", ".csv", str(tmp_path))
    for private in (*names, "0.713", "1.37", "1.913", strongest):
        assert private not in text, private


@pytest.mark.parametrize("given", ["Alice.png", "Alice:", "/Alice/x", "page", "page:Alice.png"])
def test_names_that_are_no_source_are_left_out(given):
    assert _kind(given, "sources") == ("page:" if given.startswith("page:") else "other")


def test_versions_and_firmwares_are_no_words():
    firmwares = ("eTactileKit 71adee2, 1024 outputs", "link-4.1 of Alice", "Alice", "of Alice 2")
    told = [found and found[0] for found in map(_FIRMWARE.match, firmwares)]
    assert told == ["eTactileKit 71adee2", "link-4.1", None, None]
    assert [_version(each) for each in ("1.2.3", "Alice", 5, None)] == ["1.2.3", None, None, None]


def test_no_recording_is_one_sentence(program_here, tmp_path):
    done = program_here("report", tmp_path / "none.mcap")
    says(RecordingError, about="file", value=tmp_path / "none.mcap")(done.error)
