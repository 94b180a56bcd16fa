"""Ceilings of the project: a profile may lower them, never raise them.

``docs/safety/limits.md`` has the source of each, a norm, a paper, or why it is ours.
"""

CEILING_MA = 5.0  # of an electrode
CEILING_TOTAL_MA = 10.0  # of all electrodes in a slot
CEILING_PULSE_US = 200.0
CEILING_CHARGE_UC = 0.5  # of a pulse
CEILING_DENSITY_UC_CM2 = 100.0  # of a pulse
CEILING_SHANNON_K = 1.75  # of a pulse
LEAST_DISCHARGE_US = 20  # after each pulse
CEILING_RATE_HZ = 200.0  # sequences a second
CEILING_DUTY = 0.8  # share of the time that current flows
SHORTEST_RAMP_S = 0.5  # from zero to full
CEILING_PULSES_HZ = 1500.0  # felt pulses of an electrode
CEILING_MEAN_MA = 0.5  # of an electrode
CEILING_NET_MA = 0.05  # of an electrode
CEILING_AREA_MM2 = 400.0
CEILING_ELECTRODES = 0xFFFF
BURST_S = 0.04  # longest time whose pulses one sequence may bring at once
CEILING_SESSION_S = 3600.0
CEILING_SESSION_MC = 1800.0  # through an electrode
CEILING_USER_MA = 20.0  # of all displays of a user together
ADVISORY_RMS_MA_CM2 = 2.0
"""Reported and not enforced: IEC 60601-2-10 wants the operator's attention above 2 mA/cm² r.m.s.,
which electrodes of a millimeter always exceed."""
