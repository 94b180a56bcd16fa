"""Sequences that are not what they seem: what a gate lets through is safe, plain and for good."""

import dataclasses
import itertools

import numpy as np
import pytest

from smarttouch.stimulation.scan_sequence import ScanSequence

from .bounds import LATE_NS
from .displays import display
from .drafts import opening
from .gates import GateUnderTest, faults_of_copy
from .oracle import Oracle

NS = 10**9
PROFILE = display("line-7")


def sequence(level_ua=300, kind=ScanSequence, **other):
    row = np.array([[level_ua, -level_ua, 0, 0, 0, 0, 0]], np.int16)
    one = np.ones(1, np.uint16)
    fields = {
        "current_ua": row, "width_us": one * 100, "discharge_us": one * 50, "site": one,
        "period_us": 20_000, "intensity": 1.0, "time_ns": NS,
    }  # fmt: skip
    return kind(**fields | other)


def silent():
    return sequence(0, intensity=0.0, time_ns=0)


def asked(made):
    """Return what a gate says of a sequence, a second after a silent one; judge its copy."""
    gate, oracle = GateUnderTest(PROFILE), Oracle(PROFILE)
    assert gate.ask(silent(), 0).accepted
    assert oracle.judge(silent(), 0) == []
    for time_ns in range(1, oracle.bounds.ramp_ns + LATE_NS, LATE_NS):
        draft = opening(oracle, time_ns, time_ns)
        assert gate.ask(draft.made(), time_ns).accepted
        assert oracle.judge(draft.made(), time_ns) == []
    answer = gate.ask(made, NS)
    if answer.accepted:
        # Whatever was asked about: what is sent is this copy.
        assert faults_of_copy(answer.copy, answer.copy) == []
        assert oracle.judge(answer.copy, NS) == []
    return answer


class TwoFaced(ScanSequence):
    """Shows another level each time it is looked at."""

    looks, odd = 0, False

    def __getattribute__(self, name):
        value = super().__getattribute__(name)
        if name != "current_ua":
            return value
        object.__setattr__(self, "looks", super().__getattribute__("looks") + 1)
        return value * np.int16(1 + 9 * (self.looks % 2 == type(self).odd))


class Modest(ScanSequence):
    """Says that it has no slots, and another rate."""

    slots = 0
    points = 0
    rate_hz = 1.0
    electrodes = 7
    state = source_ua = None


class Meek(np.ndarray):
    """An array that says of itself that it is small."""

    def max(self, *_, **__):
        return 0

    min = sum = any = max

    def all(self, *_, **__):
        return True

    def tolist(self):
        return [0] * len(self)

    def astype(self, kind, *_, **__):
        return np.zeros(self.shape, kind)

    def copy(self, *_):
        return np.zeros(self.shape, self.dtype)

    def tobytes(self, *_):
        return bytes(self.nbytes)

    def __array_ufunc__(self, ufunc, method, *inputs, **named):
        plain = [np.zeros(x.shape, x.dtype) if isinstance(x, Meek) else x for x in inputs]
        named.pop("out", None)
        return getattr(ufunc, method)(*plain, **named)

    def __array_function__(self, function, types, given, named):
        return np.zeros(self.shape, self.dtype)


def agreeable(value, looks):
    """Return a number that is never too large nor too small, and looks like another."""
    kind = type(value)
    lies = dict.fromkeys(("__lt__", "__le__", "__gt__", "__ge__", "__eq__"), lambda *_: True)
    lies |= dict.fromkeys(("__int__", "__index__", "__float__"), lambda _: looks)
    return type("Agreeable", (kind,), lies | {"__hash__": lambda _: 0})(value)


@pytest.mark.parametrize("level_ua", [300, 3000])
@pytest.mark.parametrize("kind", [TwoFaced, type("Odd", (TwoFaced,), {"odd": True}), Modest])
def test_a_sequence_that_lies(kind, level_ua):
    answer = asked(sequence(level_ua, kind))
    assert answer.accepted in (True, False)
    if kind is Modest:
        assert not (answer.accepted and level_ua == 3000)


@pytest.mark.parametrize(("name", "value"), [
    ("current_ua", 3000), ("width_us", 60_000), ("discharge_us", 3), ("site", 60_000),
])  # fmt: skip
def test_an_array_that_lies(name, value):
    made = sequence()
    array = getattr(made, name)
    lying = (array // array.max() * value).astype(array.dtype).view(Meek)
    answer = asked(dataclasses.replace(made, **{name: lying}))
    if answer.accepted:
        assert value not in getattr(answer.copy, name)


@pytest.mark.parametrize(("names", "looks", "values"), [
    (["period_us", "time_ns"], 20_000, [1, -5, 2**63, 10**30]),
    (["intensity"], 1.0, [float("nan"), float("inf"), 7.0, -1.0]),
])  # fmt: skip
def test_a_number_that_lies(names, looks, values):
    for name, value in itertools.product(names, values):
        asked(sequence(**{name: agreeable(value, looks)}))


@pytest.mark.parametrize("name", ["current_ua", "width_us", "discharge_us", "site"])
def test_what_is_changed_after_the_proof_changes_nothing(name):
    made = sequence()
    answer = asked(made)
    assert answer.accepted
    before = getattr(answer.copy, name).tolist()
    getattr(made, name)[:] = 30_000
    assert getattr(answer.copy, name).tolist() == before
    assert not np.shares_memory(getattr(answer.copy, name), getattr(made, name))


def test_a_copy_cannot_be_written():
    copy = asked(sequence()).copy
    for name in ("current_ua", "width_us", "discharge_us", "site"):
        array = getattr(copy, name)
        with pytest.raises(ValueError):
            array[:] = 0
        with pytest.raises(ValueError):
            array.setflags(write=True)
        with pytest.raises(ValueError):
            array.view().setflags(write=True)
    with pytest.raises(dataclasses.FrozenInstanceError):
        copy.period_us = 1
