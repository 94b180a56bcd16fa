"""Events of a run arrive on the Lab Streaming Layer, in order and on time."""

import sys
import types
from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.afferent import Mode
from smarttouch.base.clock import SimulatedClock
from smarttouch.base.errors import MarkersError
from smarttouch.base.events import Note
from smarttouch.boards.open import MemoryBoard
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Frame, OpticalSource, Pose
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.views.lsl_markers import FRAMES, PULSES, Markers

from ..looping import loop_through
from ..raising import raises


class Bars(OpticalSource):
    """A few frames of black bars, each a little farther on the page."""

    def __init__(self, most):
        super().__init__("bars")
        self.knows_force, self.most = True, most

    def read(self, time_ns):
        if self.frames == self.most:
            return None
        image = np.full((64, 64), 220, np.uint8)
        image[:, 20:30] = 20
        self.frames += 1
        return Frame(image, time_ns, Pose(self.frames, 2.0), 0.5, self.frames - 1)


class FakeLsl(types.ModuleType):
    """Keeps what is pushed; its clock stands still unless it is set."""

    cf_string, cf_double64, IRREGULAR_RATE = 3, 2, 0.0

    def __init__(self, refuse=None):
        super().__init__("pylsl")
        self.now_s, self.pushed, self.infos, self.refuse = 100.0, {}, [], refuse

    def local_clock(self):
        return self.now_s

    def StreamInfo(self, name, kind, channels, rate, form, source):  # noqa: N802
        node = types.SimpleNamespace(append_child_value=lambda *_: None)
        node.append_child = lambda _: node
        self.infos.append((name, kind, channels, rate, form, source))
        return types.SimpleNamespace(name=name, desc=lambda: node)

    def StreamOutlet(self, info):  # noqa: N802
        if self.refuse is not None:
            raise self.refuse
        pushed = self.pushed[info.name] = []
        return types.SimpleNamespace(push_sample=lambda sample, at_s: pushed.append((at_s, sample)))


@pytest.fixture
def lsl(monkeypatch):
    fake = FakeLsl()
    monkeypatch.setitem(sys.modules, "pylsl", fake)
    monkeypatch.setattr("smarttouch.views.lsl_markers._LINGER_S", 0.0)
    return fake


@pytest.fixture
def felt(profile, bank):
    """Return a runner of a few frames, and the steps that were sent."""

    def felt(markers, most=30):
        steps = []
        with MemoryBoard("", SafetyLimits.of(profile), profile.output) as board:
            # Nothing is late, however busy the machine is.
            board._clock = SimulatedClock()
            pipeline = Pipeline(profile, bank, RunConfig(mode=Mode.RA, scan="points"))
            loop_through(Bars(most), pipeline, board, markers, steps.append)
        return steps

    return felt


def opened(profile, source=None):
    """Return markers whose outlets are there."""
    markers = Markers(source)
    markers.prepare(types.SimpleNamespace(profile=profile))
    return markers


class TestWhatIsTold:
    def test_every_sequence_frame_and_event_has_its_sample(self, lsl, profile, felt):
        markers = opened(profile)
        steps = felt(markers)
        pulses = lsl.pushed["smarttouch-pulses"]
        frames = lsl.pushed["smarttouch-frames"]
        assert len(pulses) == len(frames) == len(steps) == 30
        for step, (at_s, pulse), (seen_s, frame) in zip(steps, pulses, frames, strict=True):
            sequence = step.step.sequence
            strongest = np.abs(sequence.current_ua).max() / 1000 if sequence.slots else 0
            assert pulse == [
                step.number, sequence.slots, strongest, sequence.intensity, sequence.period_us,
            ]  # fmt: skip
            assert frame == [step.step.input.number, step.step.input.pose.x_mm, 2.0, 0.5]
            assert at_s == seen_s == pytest.approx(100 + sequence.time_ns / 1e9, abs=0.05)
        assert pulses[-1][1][2] > 0
        told = lsl.pushed["smarttouch-events"]
        assert len(told) == 3
        assert [words for _, [words] in told[:2]] == ["intensity 1.00", "mode RA"]
        assert told[-1][0] - told[0][0] == pytest.approx(30 / profile.pulse.rate_hz)

    def test_the_streams_describe_themselves(self, lsl, profile):
        opened(profile, "here")
        assert lsl.infos == [
            ("smarttouch-pulses", "Stimulation", len(PULSES), 0, 2, "smarttouch-pulses-here"),
            ("smarttouch-frames", "Position", len(FRAMES), 0, 2, "smarttouch-frames-here"),
            ("smarttouch-events", "Markers", 1, 0, 3, "smarttouch-events-here"),
        ]

    def test_a_sequence_that_was_lost_has_no_number(self, lsl, profile, felt):
        markers = opened(profile)
        step = felt(markers, 1)[0]
        markers.step(StepResult(step.step, None, 0.0))
        assert lsl.pushed["smarttouch-pulses"][-1][1][0] == -1


class TestTime:
    def step(self, felt, markers, time_ns):
        step = self.first = getattr(self, "first", None) or felt(markers, 1)[0].step
        return StepResult(replace(step, input=replace(step.input, time_ns=time_ns)), 1, 500.0)

    def watched(self, lsl, profile, felt, late_s):
        """Return how far stamps are off the schedule, for steps that come so late."""
        template = self.step(felt, opened(profile), 0)
        markers, off_s = opened(profile), []
        for index, late in enumerate(late_s):
            time_ns = index * 20_000_000
            lsl.now_s = 100 + time_ns / 1e9 + late + 0.0005
            markers.step(self.step(felt, markers, time_ns))
            off_s.append(lsl.pushed["smarttouch-pulses"][-1][0] - 100 - time_ns / 1e9)
        assert template.latency_us == 500
        return off_s

    def test_a_single_late_step_moves_nothing(self, lsl, profile, felt):
        late_s = [0.0] * 20 + [0.015] + [0.0] * 20
        assert self.watched(lsl, profile, felt, late_s) == pytest.approx([0.0] * 41, abs=1e-9)

    def test_a_schedule_that_moved_is_followed(self, lsl, profile, felt):
        late_s = [0.0] * 20 + [0.3] * 16 + [0.315] + [0.3] * 30
        off_s = self.watched(lsl, profile, felt, late_s)
        assert off_s[:20] == pytest.approx([0.0] * 20, abs=1e-9)
        assert off_s[36:] == pytest.approx([0.3] * 31, abs=1e-9)

    def test_an_event_before_the_first_step_begins_the_time(self, lsl, profile):
        markers = opened(profile)
        markers.event(Note(2_000_000_000, "one"))
        lsl.now_s = 777.0
        markers.event(Note(3_500_000_000, "two"))
        assert lsl.pushed["smarttouch-events"] == [(100.0, ["one"]), (101.5, ["two"])]


class TestFaults:
    def test_a_fault_in_the_run_is_noted_once_and_ends_nothing(self, lsl, profile, felt):
        markers = opened(profile)

        fault = RuntimeError("an internal error has occurred")

        def refuse(sample, at_s):
            raise fault

        markers._frames.push_sample = refuse
        assert len(felt(markers)) == 30
        (note,) = markers.notes
        assert str(fault) in note
        markers.close()

    def test_a_fault_at_the_start_is_an_error(self, lsl, profile):
        lsl.refuse = RuntimeError("could not create stream outlet.")
        with raises(MarkersError, about="markers") as error:
            opened(profile)
        assert str(lsl.refuse) in str(error.value)

    @pytest.mark.parametrize(("missing", "about", "remedy"), [
        (ImportError(), "extra", "pip install 'smarttouch[lsl]'"),
        (RuntimeError("no library"), "liblsl", "https://labstreaminglayer.org"),
    ])  # fmt: skip
    def test_what_is_missing_is_named(self, profile, monkeypatch, missing, about, remedy):
        def refuse(name):
            raise missing

        monkeypatch.setattr("smarttouch.base.lazy_names.import_module", refuse)
        with raises(MarkersError, about=about, remedy=remedy) as error:
            opened(profile)
        assert remedy in str(error.value)

    def test_after_closing_nothing_is_pushed(self, lsl, profile):
        markers = opened(profile)
        for _ in range(2):
            markers.close()
        markers.event(Note(0, "late"))
        assert lsl.pushed["smarttouch-events"] == []
        assert markers.notes == []


def test_everything_arrives_over_the_real_layer(profile, felt):
    try:
        markers = opened(profile, "test of markers")
    except MarkersError as missing:
        pytest.skip(str(missing))
    import pylsl

    inlets = {}
    for name in ("pulses", "events"):
        source = f"smarttouch-{name}-test of markers"
        found = pylsl.resolve_byprop("source_id", source, timeout=5)
        if not found:
            pytest.skip("this network carries no streams")
        inlets[name] = pylsl.StreamInlet(found[0])
        inlets[name].open_stream(timeout=60)
    described = inlets["pulses"].info(timeout=60)
    assert described.get_channel_labels() == [label for label, _ in PULSES]
    assert described.get_channel_units() == [unit for _, unit in PULSES]
    assert described.desc().child_value("profile") == profile.name
    began_s = pylsl.local_clock()
    steps = felt(markers)
    markers.event(Note(1_000_000_000, "trial 1: “A”, 30 Hz"))
    got = [inlets["pulses"].pull_sample(timeout=60) for _ in steps]
    for step, (pulse, at_s) in zip(steps, got, strict=True):
        assert pulse[:2] == [step.number, step.step.sequence.slots]
        assert at_s - got[0][1] == pytest.approx(step.step.sequence.time_ns / 1e9)
    assert began_s <= got[0][1] <= pylsl.local_clock()
    events = [inlets["events"].pull_sample(timeout=60) for _ in range(4)]
    assert [each[0] for each, _ in events][0::3] == ["intensity 1.00", "trial 1: “A”, 30 Hz"]
    assert events[3][1] - events[0][1] == pytest.approx(1)
    for inlet in inlets.values():
        inlet.close_stream()
    markers.close()
