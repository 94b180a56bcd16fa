"""Ceilings of the project: profiles may lower them, but never raise them.

``docs/safety/limits.md`` has the source of each.
"""

CEILING_MA = 5.0  # per electrode
CEILING_TOTAL_MA = 10.0  # sum of all electrodes in a slot
CEILING_PULSE_US = 200.0
CEILING_CHARGE_UC = 0.5  # per pulse
CEILING_DENSITY_UC_CM2 = 100.0  # per pulse
CEILING_SHANNON_K = 1.75  # per pulse
LEAST_DISCHARGE_US = 20  # after each pulse
CEILING_RATE_HZ = 200.0  # sequences per second
CEILING_DUTY = 0.8  # share of the time with current
SHORTEST_RAMP_S = 0.5  # from zero to full intensity
CEILING_PULSES_HZ = 1500.0  # perceptible pulses per electrode
CEILING_MEAN_MA = 0.5  # per electrode
CEILING_NET_MA = 0.05  # per electrode
CEILING_AREA_MM2 = 400.0
CEILING_ELECTRODES = 0xFFFF
BURST_S = 0.04  # longest time whose pulses one sequence may deliver at once
CEILING_SESSION_S = 3600.0
CEILING_SESSION_MC = 1800.0  # per electrode
CEILING_USER_MA = 20.0  # sum over all displays of a user
ADVISORY_RMS_MA_CM2 = 2.0
"""Reported but not enforced: IEC 60601-2-10 requires attention of the operator above 2 mA/cm²
r.m.s., which electrodes of 1 mm always exceed."""
