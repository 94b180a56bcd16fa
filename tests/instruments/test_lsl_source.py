"""Streams of the Lab Streaming Layer, from real outlets: images, activations, and who may send."""

import sys
import time
import uuid

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.errors import SourceError
from smarttouch.instruments import lsl_source, pushed_stimuli
from smarttouch.testing import SourceContract, StimulusContract

from ..raising import raises
from ..waiting import until

pylsl = pytest.importorskip("pylsl")


@pytest.fixture
def outlet():
    """Return a maker of outlets, each of a name of its own."""
    made = []

    def make(channels, kind="float32"):
        name = f"smarttouch-test-{uuid.uuid4().hex}"
        made.append(pylsl.StreamOutlet(pylsl.StreamInfo(name, "Tactile", channels, 60, kind, name)))
        return name, made[-1]

    yield make
    made.clear()


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    monkeypatch.setattr(pushed_stimuli, "SILENT_S", 1000)
    monkeypatch.setattr(lsl_source, "FIND_S", 20.0)


@pytest.mark.parametrize(("rows", "kind"), [(1, "float32"), (3, "float32"), (3, "double64")])
def test_activations_of_all_classes_or_of_each(profile, outlet, rows, kind):
    name, stream = outlet(64 * rows, kind)
    own = np.random.default_rng(1).random((rows, 64)).astype(np.float32)
    with st.open_source(f"lsl:{name}", profile) as source:
        stream.push_sample(own.ravel().tolist())
        until(lambda: source.given)
        np.testing.assert_array_equal(source.read(0).activation, np.broadcast_to(own, (3, 64)))
        stream.push_sample([2.0] * 64 * rows)
        until(lambda: source.wrong)
        assert source.given == 1
    assert "1 activations" in source.notes[0]


def test_a_stream_that_ends_is_found_again(profile):
    name = f"smarttouch-test-{uuid.uuid4().hex}"
    info = pylsl.StreamInfo(name, "Tactile", 64, 60, "float32", name)
    stream = pylsl.StreamOutlet(info)
    with st.open_source(f"lsl:{name}", profile) as source:
        del stream
        stream = pylsl.StreamOutlet(info)
        over_s = time.monotonic() + 60
        while not source.given:
            stream.push_sample([1.0] * 64)
            time.sleep(0.01)
            assert time.monotonic() < over_s


def test_a_stream_of_somebody_else_is_refused(profile, outlet, monkeypatch):
    """Its connection ends in a socket that is not this user's."""
    name, _ = outlet(64)
    monkeypatch.setattr("os.geteuid", lambda: 12345)
    with raises(SourceError, about="name", value=name):
        st.open_source(f"lsl:{name}", profile)


@pytest.mark.parametrize(("channels", "kind", "query", "about"), [
    (65, "float32", "", "channels"), (64, "float32", "?size=8x9", "size"),
    (64, "string", "", "name"),
])  # fmt: skip
def test_streams_that_do_not_fit_are_one_sentence(profile, outlet, channels, kind, query, about):
    name, _ = outlet(channels, kind)
    with raises(SourceError, about=about):
        st.open_source(f"lsl:{name}{query}", profile)


def test_no_stream_is_one_sentence(profile, monkeypatch, tmp_path):
    monkeypatch.setattr(lsl_source, "FIND_S", 0.2)
    with raises(SourceError, about="name", value="smarttouch-none"):
        st.open_source("lsl:smarttouch-none", profile)
    with raises(SourceError, about="name"):
        st.open_source("lsl:", profile)
    monkeypatch.setattr(lsl_source, "TCP_TABLES", (tmp_path / "none",))
    with raises(SourceError, about="lsl"):
        st.open_source("lsl:smarttouch-none", profile)


def test_gray_levels_have_a_range(profile, outlet):
    name, stream = outlet(64)
    with st.open_source(f"lsl:{name}?size=8x8", profile) as source:
        stream.push_sample([300.0] * 64)
        with raises(SourceError, about="image", value="300"):
            source.read(0)


def test_without_the_extra_it_says_which(profile, monkeypatch):
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with raises(SourceError, about="lsl"):
        st.open_source("lsl:Tactile", profile)


class TestImages(SourceContract):
    ends = False

    @pytest.fixture(autouse=True)
    def stream(self, outlet):
        self.name, self.stream = outlet(64, "int32")

    def make(self, profile):
        source = st.open_source(f"lsl:{self.name}?size=8x8", profile)
        self.pause()
        return source

    def make_impossible(self, profile):
        st.open_source("lsl:", profile)

    def pause(self):
        self.stream.push_sample(np.random.default_rng(1).integers(0, 256, 64).tolist())
        time.sleep(0.02)


class TestStimuli(StimulusContract):
    ends = False

    @pytest.fixture(autouse=True)
    def stream(self, outlet):
        self.name, self.stream = outlet(64)

    def make(self, profile):
        return st.open_source(f"lsl:{self.name}", profile)

    def make_impossible(self, profile):
        st.open_source("lsl:", profile)

    def pause(self):
        self.stream.push_sample(np.random.default_rng(1).random(64).tolist())
        time.sleep(0.01)
