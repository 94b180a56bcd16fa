"""Safety ceilings of the project: a profile can set stricter limits, but never weaker ones.

``docs/safety/limits.md`` names the source of each ceiling.
"""

CEILING_MA = 5.0  # largest current of an electrode
CEILING_TOTAL_MA = 10.0  # largest total current of all cathodes in a slot
CEILING_PULSE_US = 200.0
CEILING_CHARGE_UC = 0.5  # largest charge of a pulse
CEILING_DENSITY_UC_CM2 = 100.0  # largest charge of a pulse per area of the electrode
CEILING_SHANNON_K = 1.75  # largest k of a pulse in Shannon's equation
LEAST_DISCHARGE_US = 20  # shortest discharge after a pulse
CEILING_RATE_HZ = 200.0  # largest number of sequences per second
CEILING_DUTY = 0.8  # largest share of time in which current flows
SHORTEST_RAMP_S = 0.5  # shortest time from zero to full intensity
CEILING_PULSES_HZ = 1500.0  # largest number of perceptible pulses of an electrode per second
CEILING_MEAN_MA = 0.5  # largest mean magnitude of an electrode's current
CEILING_NET_MA = 0.05  # largest net current of an electrode (mean of its signed current)
CEILING_AREA_MM2 = 400.0
CEILING_ELECTRODES = 0xFFFF
BURST_S = 0.04  # longest time over which the charge of one sequence is averaged
CEILING_SESSION_S = 3600.0
CEILING_SESSION_MC = 1800.0  # largest charge through an electrode in a session
CEILING_USER_MA = 20.0  # largest total current of all displays of a user
ADVISORY_RMS_MA_CM2 = 2.0
"""R.m.s. current density above which a run prints a note, because IEC 60601-2-10 then requires the
operator's attention. The run goes on, because electrodes of 1 mm always exceed 2 mA/cm²."""
