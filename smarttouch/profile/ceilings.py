"""Ceilings of the project, each with its source: a profile may lower them, never raise them."""

from typing import NamedTuple


class Ceiling(NamedTuple):
    """One ceiling."""

    name: str
    value: float
    unit: str
    source: str  # norm or paper that it comes from, or why it is ours; whole sentences


CEILING_MA = 5.0
CEILING_TOTAL_MA = 10.0
CEILING_PULSE_US = 200.0
CEILING_CHARGE_UC = 0.5
CEILING_DENSITY_UC_CM2 = 100.0
CEILING_SHANNON_K = 1.75
LEAST_DISCHARGE_US = 20
CEILING_RATE_HZ = 200.0
CEILING_DUTY = 0.8
SHORTEST_RAMP_S = 0.5
CEILING_PULSES_HZ = 1500.0
CEILING_MEAN_MA = 0.5
CEILING_NET_MA = 0.05
CEILING_AREA_MM2 = 400.0
CEILING_ELECTRODES = 0xFFFF
BURST_S = 0.04
CEILING_SESSION_S = 3600.0
CEILING_SESSION_MC = 1800.0
CEILING_USER_MA = 20.0
ADVISORY_RMS_MA_CM2 = 2.0

CEILINGS = (
    Ceiling(
        "current of an electrode",
        CEILING_MA,
        "mA",
        "Below the 6 mA cap of a published fingertip protocol; AS 60601.2.10 asks that outputs "
        "above 10 mA are stated.",
    ),
    Ceiling(
        "current of all electrodes in a slot",
        CEILING_TOTAL_MA,
        "mA",
        "Ours: what AS 60601.2.10 (201.7.9.2.101) lets an output carry without being stated. A "
        "full frame of every shipped profile needs at most 9.98 mA.",
    ),
    Ceiling("pulse width", CEILING_PULSE_US, "µs", "The paper's own pulses (Section III-A)."),
    Ceiling(
        "charge of a pulse",
        CEILING_CHARGE_UC,
        "µC",
        "Ours: the paper's 2.4 mA for 200 µs carry 0.48 µC.",
    ),
    Ceiling(
        "charge density of a pulse",
        CEILING_DENSITY_UC_CM2,
        "µC/cm²",
        "Ours: the paper's pulse through a disc of 1 mm is 61 µC/cm², through the 0.8 mm disc of "
        "the Optacon's array 96.",
    ),
    Ceiling(
        "Shannon's k of a pulse",
        CEILING_SHANNON_K,
        "",
        "Shannon 1992 puts the edge of damage, found on cat cortex, near 1.85; no such number is "
        "known for skin. Full frames of the shipped profiles reach 1.66.",
    ),
    Ceiling(
        "least discharge after each pulse",
        LEAST_DISCHARGE_US,
        "µs",
        "Ours: ten time constants of the electrode model (2 kΩ before 50 kΩ beside 1 nF), after "
        "which less than 0.02 nC of any allowed pulse is left, and successive pulses do not add "
        "up to a longer one.",
    ),
    Ceiling(
        "sequences a second",
        CEILING_RATE_HZ,
        "Hz",
        "The highest rate of the paper's experiments (Section III-A).",
    ),
    Ceiling(
        "share of the time that current flows",
        CEILING_DUTY,
        "",
        "Ours: leaves every pulse of 200 µs the 50 µs that its discharge needs. Recharge phases "
        "count as pulses do.",
    ),
    Ceiling(
        "rise from zero to full, at least",
        SHORTEST_RAMP_S,
        "s",
        "Ours: devices begin at zero and ramp, and a startled subject must have time to pull away.",
    ),
    Ceiling(
        "felt pulses of an electrode",
        CEILING_PULSES_HZ,
        "1/s",
        "Ours: pulses of at least half the electrode's threshold, its returns included. Full "
        "frames of the shipped profiles bring 50 to 300 in RA and SAI and 1,150 in PC.",
    ),
    Ceiling(
        "mean current of an electrode",
        CEILING_MEAN_MA,
        "mA",
        "Ours: full frames of the shipped profiles bring at most 0.28 mA. Over a second, and in "
        "each sequence over its own period.",
    ),
    Ceiling(
        "net current of an electrode",
        CEILING_NET_MA,
        "mA",
        "The direct current at which a Digitimer DS5 stops. Charge with its sign, recharge phases "
        "included, over any second.",
    ),
    Ceiling(
        "longest time whose pulses one sequence may bring at once",
        BURST_S,
        "s",
        "Ours: a slow sequence may not save up its pulses for one burst; 60 felt pulses and 20 µC "
        "an electrode. A full frame of 144 electrodes in natural mode brings 11 and 9.2 µC.",
    ),
    Ceiling(
        "session",
        CEILING_SESSION_S,
        "s",
        "Ours: an hour of scans with current, after which the skin is inspected.",
    ),
    Ceiling(
        "charge through an electrode in a session",
        CEILING_SESSION_MC,
        "mC",
        "Ours: an hour at the mean current above.",
    ),
    Ceiling(
        "current of all displays of a user together",
        CEILING_USER_MA,
        "mA",
        "Ours: two displays at the ceiling of a slot; each display has its own clock, so their "
        "pulses may coincide.",
    ),
)
"""All enforced ceilings. `ADVISORY_RMS_MA_CM2` is reported and not enforced: IEC 60601-2-10 wants
the operator's attention above 2 mA/cm² r.m.s., which electrodes of a millimeter always exceed."""
