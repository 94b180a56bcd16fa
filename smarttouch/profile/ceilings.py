"""Safety ceilings of the project: a profile can set stricter limits, but never weaker ones.

``docs/safety/limits.md`` names the source of each ceiling.
"""

CEILING_MA = 5.0  # per electrode
CEILING_TOTAL_MA = 10.0  # sum of all electrodes in a slot
CEILING_PULSE_US = 200.0
CEILING_CHARGE_UC = 0.5  # per pulse
CEILING_DENSITY_UC_CM2 = 100.0  # per pulse
CEILING_SHANNON_K = 1.75  # per pulse
LEAST_DISCHARGE_US = 20  # after each pulse
CEILING_RATE_HZ = 200.0  # sequences per second
CEILING_DUTY = 0.8  # share of time in which current flows
SHORTEST_RAMP_S = 0.5  # from zero to full intensity
CEILING_PULSES_HZ = 1500.0  # perceptible pulses per second and electrode
CEILING_MEAN_MA = 0.5  # mean of the current's magnitude, per electrode
CEILING_NET_MA = 0.05  # mean of the signed current, per electrode
CEILING_AREA_MM2 = 400.0
CEILING_ELECTRODES = 0xFFFF
BURST_S = 0.04  # a sequence can deliver the charge that the mean limits allow in this time
CEILING_SESSION_S = 3600.0
CEILING_SESSION_MC = 1800.0  # per electrode
CEILING_USER_MA = 20.0  # sum over all displays of a user
ADVISORY_RMS_MA_CM2 = 2.0
"""Current density above which a run reports its density. IEC 60601-2-10 requires the operator's
attention above 2 mA/cm² r.m.s. This is not enforced: electrodes of 1 mm always exceed it."""
