/* Limits of a session, and the rise of its intensity. */
#include "st_inside.h"

/* Take the limits of a session, capped by the board's own. */
bool st_limits_take(st_board *board, const uint8_t *payload, uint32_t size)
{
    st_limits *limits = &board->limits;
    const uint32_t electrodes = board->config.electrodes;
    if (limits->given) {
        return true;
    }
    if (size != 28u + 8u * electrodes) {
        return false;
    }
    const bool weighted = board->config.output == ST_WEIGHTED;
    const uint32_t period_us = st_u32(payload);
    const uint32_t given_ms = st_u16(payload + 16);
    uint32_t ramp_ms = given_ms == 0u ? ST_SAFE_RAMP_MS : given_ms;
    limits->period_us = period_us < ST_MIN_PERIOD_US ? ST_MIN_PERIOD_US : period_us;
    limits->total_ua =
        st_least(st_u32(payload + 4), weighted ? ST_MAX_TOTAL_UA : ST_MAX_SOURCE_UA);
    limits->width_us = st_least(st_u16(payload + 8), ST_MAX_WIDTH_US);
    limits->full_ua = st_least(st_u16(payload + 10), ST_MAX_CURRENT_UA);
    limits->rounding_ua = st_least(st_u16(payload + 12), (electrodes + 1u) / 2u + 1u);
    ramp_ms = ramp_ms < board->config.ramp_ms ? board->config.ramp_ms : ramp_ms;
    ramp_ms = ramp_ms < ST_MIN_RAMP_MS ? ST_MIN_RAMP_MS : ramp_ms;
    limits->ramp_us = 1000u * ramp_ms;
#ifdef ST_FOR_TESTS
    limits->ramp_us = board->config.no_ramp ? 0u : limits->ramp_us;
#endif
    limits->session_s = st_least(st_u16(payload + 18), ST_MAX_SESSION_S);
    limits->session_uc = st_least(st_u32(payload + 20), ST_MAX_SESSION_UC);
    limits->duty_percent = st_least(payload[24], ST_MAX_DUTY_PERCENT);
    limits->usual_us = st_least(st_u16(payload + 26), ST_MAX_WIDTH_US);
    const uint8_t *current = payload + 28;
    const uint8_t *felt = current + 2u * electrodes;
    const uint8_t *charge = felt + 2u * electrodes;
    for (uint32_t index = 0; index < electrodes; index++) {
        st_electrode *each = &board->config.each[index];
        each->limit_ua = (uint16_t)st_least(st_u16(current + 2u * index), ST_MAX_CURRENT_UA);
        each->felt_ua = (uint16_t)st_least(st_u16(felt + 2u * index), ST_MAX_FELT_UA);
        each->limit_pc = st_least(st_u32(charge + 4u * index), ST_MAX_CHARGE_PC);
    }
    limits->given = true;
    return true;
}

/* Return how far intensity has risen, and the time with current since the last sequence. */
static uint32_t risen(const st_board *board, const st_ramp *ramp, uint64_t start_us,
                      uint64_t *flowing_us)
{
    const uint64_t ramp_us = board->limits.ramp_us;
    const uint64_t passed_us = start_us > ramp->since_us ? start_us - ramp->since_us : 0u;
    *flowing_us = passed_us < ramp->span_us ? passed_us : ramp->span_us;
    if (passed_us - *flowing_us > ST_LEVEL_KEPT_US) {
        return 0;
    }
    const uint32_t rises =
        *flowing_us >= ramp_us ? ST_FULL : (uint32_t)(*flowing_us * ST_FULL / ramp_us);
    const uint32_t level = st_least(ramp->strength, ramp->level + rises);
    /* Weak current lowers nothing. */
    return level > ramp->level ? level : ramp->level;
}

/* Return what a sequence's intensity amounts to, from 0 to 65,535. */
uint16_t st_strength(const st_limits *limits, uint32_t intensity, uint32_t peak_pc)
{
    const uint32_t full_pc = limits->full_ua * limits->usual_us;
    if (peak_pc == 0u) {
        return 0u;
    }
    if (peak_pc >= full_pc) {
        return ST_FULL;
    }
    const uint32_t share = (uint32_t)st_upward((uint64_t)peak_pc * ST_FULL, full_pc);
    const uint32_t most = st_least(intensity, ST_STRENGTH * share);
    return (uint16_t)(most > share ? most : share);
}

/* Return the largest strength that may begin then; of a scan, when its first part was to. */
uint32_t st_rise_allowed(const st_board *board, const st_sequence *sequence, uint64_t start_us)
{
    const bool goes_on = st_goes_on(sequence);
    const uint32_t ramp_us = board->limits.ramp_us;
    uint64_t flowing_us;
    if (ramp_us == 0u) {
        return ST_FULL;
    }
    const uint32_t reached = risen(board, goes_on ? &board->scan.before : &board->ramp,
                                   goes_on ? board->scan.start_us : start_us, &flowing_us);
    const uint32_t ahead = (uint32_t)((uint64_t)ST_CATCH_UP_US * ST_FULL / ramp_us);
    return st_least(ST_FULL, reached + ahead + ST_RISE_LEEWAY);
}

/* Note a sequence that will flow, for what may rise after it. */
void st_rise_note(st_board *board, const st_sequence *sequence, uint64_t start_us)
{
    st_ramp *ramp = &board->ramp;
    uint64_t flowing_us;
    const uint32_t level = risen(board, ramp, start_us, &flowing_us);
    if (sequence->strength > 0u) {
        ramp->strength = sequence->strength;
        ramp->level = st_least(sequence->intensity, level);
        ramp->since_us = start_us;
        ramp->span_us = (uint64_t)sequence->times * sequence->period_us;
    } else {
        /* What opens nothing keeps the level, and does not end the silence. */
        ramp->level = level;
        ramp->since_us += flowing_us;
        ramp->span_us = 0;
    }
}
