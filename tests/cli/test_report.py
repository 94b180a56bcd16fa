"""A file for a bug report has what helps, and nothing of participants."""

import json

import smarttouch as st
from smarttouch.errors import RecordingError

from .conftest import says


def record(path, words="Annabel", **settings):
    display = st.open_display("simulated:")
    source = st.open_source(f"text:{words}", display.profile)
    st.run(source, display, seconds=0.3, listeners=[st.Recorder(path)], **settings)


def report(program_here, tmp_path, *arguments):
    done = program_here("report", *arguments, "--output", tmp_path / "report.json")
    assert (done.returncode, done.stderr) == (0, "")
    return (tmp_path / "report.json").read_text("utf-8")


def test_versions_and_drivers(program_here, tmp_path):
    told = json.loads(report(program_here, tmp_path))
    assert told["smarttouch"] == st.__version__
    assert {"numpy", "pyserial"} <= told["packages"].keys()
    assert "link" in told["drivers"]
    assert "run" not in told


def test_a_run_without_who_felt_it(program_here, tmp_path):
    record(tmp_path / "run.mcap", subject="Berta", note="left hand")
    text = report(program_here, tmp_path, tmp_path / "run.mcap")
    run = json.loads(text)["run"]
    assert run["settings"]["board"] == "simulated:"
    assert run["settings"]["sensor"] == "text:"
    assert run["whole"]
    assert run["device"]["array"]["rows"] == 8
    for private in ("Berta", "left hand", "Annabel", "threshold", "comfort"):
        assert private not in text


def test_no_recording_is_one_sentence(program_here, tmp_path):
    done = program_here("report", tmp_path / "none.mcap")
    says(RecordingError, about="file", problem="missing", value=tmp_path / "none.mcap")(done.error)
