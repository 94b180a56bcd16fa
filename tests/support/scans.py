"""Helpers that make scan sequences, make boards that are not on a finger, and complete the ramp."""

import math
from dataclasses import replace

import numpy as np

from smarttouch.base.clock import LATE_NS
from smarttouch.boards.board import Board
from smarttouch.emulator.drivers import MemoryDriver
from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits, frozen
from smarttouch.stimulation.safety_limits import parts_per_billion
from smarttouch.stimulation.scan_sequence import ScanSequence
from smarttouch.stimulation.sequence_limits import STRENGTH, Exposure, prove_sequence


def sequence(currents, widths=200, *, electrodes=4, discharge_us=100, **other):
    """Return a sequence with a slot for each row of currents, µA; by default at full intensity."""
    currents = np.asarray(currents, np.int16).reshape(-1, electrodes)
    slots = len(currents)
    return ScanSequence(
        current_ua=currents,
        width_us=np.full(slots, widths, np.uint16),
        discharge_us=np.full(slots, discharge_us, np.uint16),
        site=np.zeros(slots, np.uint16),
        **({"period_us": 20_000, "intensity": 1.0, "time_ns": 10**9} | other),
    )


def unproved(
    sequence,
    times=1,
    number=1,
    due_ns=0,
    write_before_ns=2**62,
    session=0,
    strength_ppb=0,
    peak_ua=0,
):
    """Return a `ProvedSequence` that no gate has proved."""
    fields, forged = locals(), object.__new__(ProvedSequence)
    vars(forged).update(fields)
    return forged


def prove_alone(profile, sequence):
    """Check a single sequence against all limits except the ramp."""
    limits = SafetyLimits.of(profile)
    load = prove_sequence(frozen(sequence), limits, parts_per_billion(sequence.intensity))
    Exposure(limits).enter(sequence.time_ns, sequence.period_us, 1, load, flows=True)


def board_without_finger(profile, kind=MemoryDriver, **options):
    """Return a board that is not on a finger, with a profile's limits and a driver of ``kind``."""
    limits = SafetyLimits.of(profile)
    driver = kind("", limits, profile.output)
    usual = {"on_a_finger": False, "claimed_time": True}
    return Board(driver, limits, profile.output, **(usual | options))


def open_level(send, like, limits, time_ns=0, clock=None, electrodes=(0, 1)):
    """Complete the ramp: send a sequence of zero intensity, then weak ones of rising intensity.

    Each weak sequence is a copy of ``like`` with current through two electrodes. The times of the
    sequences begin at ``time_ns`` and span less than a second. If the gate's ``clock`` is given,
    this function advances the clock by a second. The ramp must not be longer than half a second.
    """
    first = np.zeros(2, np.uint16)
    weak = np.zeros((2, like.current_ua.shape[1]), np.int16)
    one = replace(
        like, current_ua=weak, width_us=first + limits.pulse_whole_us, discharge_us=first + 50,
        site=first, period_us=LATE_NS // 1000, proof=None, sums=None, vibration=None,
        recharge_ua=None, recharge_us=0,
    )  # fmt: skip
    none = slice(0, 0)
    send(
        replace(
            one,
            current_ua=weak[none],
            width_us=first[none],
            discharge_us=first[none],
            site=first[none],
            intensity=0.0,
            time_ns=time_ns,
            period_us=20_000,
        )
    )
    steps = math.ceil(limits.ramp_ns / LATE_NS)
    waits_ns = [20_000_000, *[LATE_NS] * steps, 980_000_000 - steps * LATE_NS]
    for step, wait_ns in enumerate(waits_ns):
        if clock is not None:
            clock.time_ns += wait_ns
        if step < steps:
            share = (step + 1) / steps
            current = np.zeros_like(weak)
            # Use the least current for this intensity. Slot 2 cancels the charge of slot 1.
            least_ua = math.ceil(share * limits.full_ua / STRENGTH)
            current[:, list(electrodes)] = [[least_ua, -least_ua], [-least_ua, least_ua]]
            send(
                replace(
                    one, current_ua=current, intensity=share, time_ns=time_ns + 1 + step * LATE_NS
                )
            )


def one_each(
    limits, level_ua, width_us, intensity, time_ns, *, cathodic, sites=None, discharge_us=100,
    period_us=0,
):  # fmt: skip
    """Return a scan with one slot per site (default: each unmasked electrode) at ``level_ua``. All
    other unmasked electrodes share the return current. At level 0 the scan has no slots."""
    unmasked = np.delete(np.arange(limits.electrodes), limits.masked)
    sites = np.asarray(unmasked if sites is None else sites, np.uint16)[: None if level_ua else 0]
    currents = np.zeros((len(sites), limits.electrodes), np.int16)
    for current, site in zip(currents, sites, strict=True):
        back = np.roll(unmasked, -np.searchsorted(unmasked, site))
        back = back[back != site]
        share, rest = divmod(level_ua, len(back))
        current[back] = -share
        current[back[:rest]] -= 1
        current[site] = level_ua
    slot_us = max(width_us + discharge_us, math.ceil(width_us / limits.duty)) + 30
    return ScanSequence(
        current_ua=currents if cathodic else -currents,
        width_us=np.full(len(sites), width_us, np.uint16),
        discharge_us=np.full(len(sites), discharge_us, np.uint16),
        site=sites,
        period_us=max(period_us, math.ceil(1e6 / limits.rate_hz), len(sites) * slot_us),
        intensity=intensity if len(sites) else 0.0,
        time_ns=time_ns,
    )
