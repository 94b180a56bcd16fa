/* Skin under electrodes that are all alike: a series resistance, and behind it a resistance beside
 * a capacitance, to one common node; as the Python emulator has it, without its spread. */
#ifndef ST_SKIN_H
#define ST_SKIN_H

#include <math.h>

#include "st_memory.h"

#define ST_SERIES_OHM 2.0e3
#define ST_PARALLEL_OHM 50e3
#define ST_CAPACITANCE_F 1.0e-9
#define ST_COMPLIANCE_V 300.0

typedef struct {
    double volts[ST_MOST_ELECTRODES]; /* of each capacitance */
    double source_v, most_v, left_c;  /* of the last pulse; the largest ones */
    uint64_t shorted_us;              /* since when, after the rest of the last pulse */
} st_skin;

/* Short all: what electrodes have in common flows back by the skin alone, the rest at once. */
static inline double st_skin_short(st_skin *skin, uint32_t electrodes, double time_s)
{
    const double common = exp(-time_s / (ST_PARALLEL_OHM * ST_CAPACITANCE_F));
    const double other = common * exp(-time_s / (ST_SERIES_OHM * ST_CAPACITANCE_F));
    double mean = 0;
    double most = 0;
    for (uint32_t each = 0; each < electrodes; each++) {
        mean += skin->volts[each] / electrodes;
    }
    for (uint32_t each = 0; each < electrodes; each++) {
        skin->volts[each] = mean * common + (skin->volts[each] - mean) * other;
        most = fmax(most, fabs(skin->volts[each]));
    }
    return most;
}

/* Pass the time up to a pulse, the pulse, and the rest after it. */
static inline void st_skin_pulse(st_skin *skin, const double *amps, uint32_t electrodes,
                                 const st_pulse *pulse)
{
    const double keeps =
        exp(-1e-6 * pulse->width_us / (ST_PARALLEL_OHM * ST_CAPACITANCE_F));
    double high = 0;
    double low = 0;
    if (pulse->start_us > skin->shorted_us) {
        (void)st_skin_short(skin, electrodes, 1e-6 * (double)(pulse->start_us - skin->shorted_us));
    }
    for (uint32_t each = 0; each < electrodes; each++) {
        double *volts = &skin->volts[each];
        *volts = *volts * keeps + amps[each] * ST_PARALLEL_OHM * (1 - keeps);
        const double end = *volts + amps[each] * ST_SERIES_OHM;
        high = amps[each] > 0 ? fmax(high, end) : high;
        low = amps[each] < 0 ? fmin(low, end) : low;
    }
    skin->source_v = fmin(high - low, ST_COMPLIANCE_V);
    skin->most_v = fmax(skin->most_v, skin->source_v);
    const double most = st_skin_short(skin, electrodes, 1e-6 * pulse->rest_us);
    skin->left_c = fmax(skin->left_c, most * ST_CAPACITANCE_F);
    skin->shorted_us = pulse->start_us + pulse->width_us + pulse->rest_us;
}

#endif
