/* Rules that every sequence is checked by, whatever the host has proved. */
#include <string.h>

#include "st_inside.h"

typedef struct {
    uint32_t peak_ua, peak_pc;
} peaks;

static uint32_t least(uint32_t one, uint32_t other)
{
    return one < other ? one : other;
}

static bool refuse(st_refusal *refusal, uint8_t rule, uint32_t slot, uint32_t electrode,
                   uint64_t value, uint64_t allowed)
{
    refusal->reason = ST_UNSAFE;
    refusal->rule = rule;
    refusal->slot = (uint16_t)slot;
    refusal->electrode = (uint16_t)electrode;
    refusal->value = (int32_t)(value > INT32_MAX ? INT32_MAX : value);
    refusal->allowed = (int32_t)(allowed > INT32_MAX ? INT32_MAX : allowed);
    return false;
}

bool st_limits_take(st_board *board, const uint8_t *payload, uint32_t size)
{
    st_limits *limits = &board->limits;
    const uint32_t electrodes = board->config.electrodes;
    if (limits->given) {
        return true;
    }
    if (size != 20u + 2u * electrodes) {
        return false;
    }
    limits->period_us = st_u32(payload);
    if (limits->period_us < ST_MIN_PERIOD_US) {
        limits->period_us = ST_MIN_PERIOD_US;
    }
    limits->total_ua = least(st_u32(payload + 4), ST_MAX_TOTAL_UA);
    limits->charge_pc = least(st_u32(payload + 8), ST_MAX_CHARGE_PC);
    limits->width_us = least(st_u16(payload + 12), ST_MAX_WIDTH_US);
    limits->full_ua = st_u16(payload + 14);
    limits->rounding_ua = st_u16(payload + 16);
    limits->full_us = st_u16(payload + 18);
    for (uint32_t each = 0; each < electrodes; each++) {
        board->config.limit_ua[each] =
            (uint16_t)least(st_u16(payload + 20u + 2u * each), ST_MAX_CURRENT_UA);
    }
    limits->given = true;
    return true;
}

static uint32_t risen(const st_board *board, uint64_t now_us)
{
    const st_ramp *ramp = &board->ramp;
    const uint64_t ramp_us = 1000u * (uint64_t)board->config.ramp_ms;
    if (!ramp->risen) {
        return ramp->level;
    }
    const uint64_t spent_us = now_us - ramp->since_us;
    if (spent_us >= ramp_us) {
        return ST_FULL;
    }
    return least(ST_FULL, ramp->level + (uint32_t)(spent_us * ST_FULL / ramp_us));
}

uint32_t st_rise_allowed(const st_board *board, uint64_t now_us)
{
    const uint32_t ramp_us = 1000u * (uint32_t)board->config.ramp_ms;
    if (ramp_us == 0u) {
        return ST_FULL;
    }
    const uint32_t ahead = (uint32_t)((uint64_t)ST_CATCH_UP_US * ST_FULL / ramp_us);
    return least(ST_FULL, risen(board, now_us) + ahead + ST_RISE_LEEWAY);
}

void st_rise_note(st_board *board, uint32_t intensity, uint64_t now_us)
{
    board->ramp.level = least(intensity, risen(board, now_us));
    board->ramp.since_us = now_us;
    board->ramp.risen = true;
}

static bool times_obey(const st_board *board, const st_sequence *sequence, st_refusal *refusal)
{
    const st_limits *limits = &board->limits;
    uint64_t busy_us = sequence->recharge_us;
    uint64_t pulses_us = 0;
    st_place place;
    st_first_slot(sequence, &place);
    while (place.slot < sequence->slots) {
        const uint32_t width_us = st_shape_width(sequence, place.shape);
        const uint32_t discharge_us = st_shape_discharge(sequence, place.shape);
        if (width_us == 0u || width_us > limits->width_us) {
            return refuse(refusal, ST_RULE_WIDTH, place.slot, ST_NOTHING, width_us,
                          limits->width_us);
        }
        if (discharge_us < ST_MIN_DISCHARGE_US) {
            return refuse(refusal, ST_RULE_DISCHARGE, place.slot, ST_NOTHING, discharge_us,
                          ST_MIN_DISCHARGE_US);
        }
        busy_us += width_us + discharge_us;
        pulses_us += width_us;
        st_next_slot(sequence, &place, board->config.electrodes);
    }
    if (busy_us > sequence->period_us) {
        return refuse(refusal, ST_RULE_FIT, ST_NOTHING, ST_NOTHING, busy_us, sequence->period_us);
    }
    const uint64_t flowing = (uint64_t)sequence->period_us * ST_MAX_DUTY_PERCENT;
    if (100u * pulses_us > flowing) {
        return refuse(refusal, ST_RULE_DUTY, ST_NOTHING, ST_NOTHING, pulses_us, flowing / 100u);
    }
    return true;
}

static bool kernels_obey(const st_board *board, const st_sequence *sequence,
                         const st_place *place, st_refusal *refusal)
{
    const uint8_t *pairs = sequence->data + place->at;
    const uint32_t count = board->keep.whole ? board->keep.count : 0u;
    uint64_t total = 0;
    for (uint32_t index = 0; index < place->pairs; index++) {
        const uint32_t kernel = st_u16(pairs + 4u * index);
        if (kernel >= count) {
            return refuse(refusal, ST_RULE_KERNEL, place->slot, ST_NOTHING, kernel, count);
        }
        total += st_u16(pairs + 4u * index + 2u);
    }
    if (total > ST_FULL) {
        return refuse(refusal, ST_RULE_SUM, place->slot, ST_NOTHING, total, ST_FULL);
    }
    return true;
}

/* Check that nothing is above an electrode's limit; add up magnitudes. */
static bool each_obeys(st_board *board, uint32_t slot, uint32_t width_us, const uint32_t share[2],
                       uint32_t total_ua, peaks *most, st_refusal *refusal)
{
    const uint32_t electrodes = board->config.electrodes;
    const int16_t *current_ua = board->config.current_ua;
    uint32_t strongest_ua = 0;
    uint32_t strongest = 0;
    for (uint32_t each = 0; each < electrodes; each++) {
        uint32_t ua = st_magnitude(current_ua[each]);
        if (share != NULL && ua != 0u) {
            ua = share[current_ua[each] > 0 ? 0 : 1];
        }
        if (ua > board->config.limit_ua[each]) {
            return refuse(refusal, ST_RULE_CURRENT, slot, each, ua, board->config.limit_ua[each]);
        }
        if (ua > strongest_ua) {
            strongest_ua = ua;
            strongest = each;
        }
        board->config.passed_pc[each] += ua * width_us;
    }
    if (total_ua > board->limits.total_ua) {
        return refuse(refusal, ST_RULE_TOTAL, slot, ST_NOTHING, total_ua, board->limits.total_ua);
    }
    const uint32_t charge_pc = strongest_ua * width_us;
    if (charge_pc > board->limits.charge_pc) {
        return refuse(refusal, ST_RULE_CHARGE, slot, strongest, charge_pc,
                      board->limits.charge_pc);
    }
    most->peak_ua = strongest_ua > most->peak_ua ? strongest_ua : most->peak_ua;
    most->peak_pc = charge_pc > most->peak_pc ? charge_pc : most->peak_pc;
    return true;
}

static bool slot_obeys(st_board *board, const st_sequence *sequence, const st_place *place,
                       peaks *most, st_refusal *refusal)
{
    const uint32_t electrodes = board->config.electrodes;
    const int16_t *current_ua = board->config.current_ua;
    const uint32_t width_us = st_shape_width(sequence, place->shape);
    uint16_t source_ua = 0;
    if ((place->kind == ST_STATES) != (board->config.output != ST_WEIGHTED)) {
        return refuse(refusal, ST_RULE_KIND, place->slot, ST_NOTHING, place->kind, 0);
    }
    if (place->kind <= ST_SUM && !kernels_obey(board, sequence, place, refusal)) {
        return false;
    }
    (void)st_slot_currents(board, sequence, place, &source_ua);
    int32_t net_ua = 0;
    uint32_t all_ua = 0;
    uint32_t poles[2] = { 0, 0 };
    bool wrong = false;
    for (uint32_t each = 0; each < electrodes; each++) {
        const int16_t ua = current_ua[each];
        net_ua += ua;
        all_ua += st_magnitude(ua);
        poles[0] += ua > 0 ? 1u : 0u;
        poles[1] += ua < 0 ? 1u : 0u;
        wrong = wrong || ua == 2 || (ua == 0 && board->config.output == ST_ONE_AGAINST_ALL);
    }
    if (board->config.output == ST_WEIGHTED) {
        if (net_ua != 0) {
            (void)refuse(refusal, ST_RULE_BALANCE, place->slot, ST_NOTHING, 0, 0);
            refusal->value = net_ua;
            return false;
        }
        return each_obeys(board, place->slot, width_us, NULL, all_ua / 2u, most, refusal);
    }
    if (wrong || poles[0] == 0u || poles[1] == 0u
        || (board->config.output == ST_ONE_AGAINST_ALL && least(poles[0], poles[1]) != 1u)) {
        return refuse(refusal, ST_RULE_STATES, place->slot, ST_NOTHING, 0, 0);
    }
    /* What one source splits equally, rounded up. */
    const uint32_t share[2] = {
        (source_ua + poles[0] - 1u) / poles[0], (source_ua + poles[1] - 1u) / poles[1]
    };
    return each_obeys(board, place->slot, width_us, share, source_ua, most, refusal);
}

static bool recharge_obeys(st_board *board, const st_sequence *sequence, st_refusal *refusal)
{
    const uint32_t electrodes = board->config.electrodes;
    const uint32_t width_us = sequence->recharge_us;
    const uint8_t *current = sequence->data + sequence->body_at - 2u * electrodes;
    int32_t net_ua = 0;
    uint32_t all_ua = 0;
    if (sequence->slots == 0u || width_us == 0u || width_us > ST_MAX_RECHARGE_US) {
        return refuse(refusal, ST_RULE_RECHARGE, ST_NOTHING, ST_NOTHING, width_us,
                      ST_MAX_RECHARGE_US);
    }
    for (uint32_t each = 0; each < electrodes; each++) {
        net_ua += st_i16(current + 2u * each);
        all_ua += st_magnitude(st_i16(current + 2u * each));
    }
    if (net_ua != 0) {
        (void)refuse(refusal, ST_RULE_BALANCE, ST_NOTHING, ST_NOTHING, 0, 0);
        refusal->value = net_ua;
        return false;
    }
    const uint32_t allowed_ua = least(ST_MAX_RECHARGE_UA, ST_MAX_RECHARGE_PC / width_us);
    for (uint32_t each = 0; each < electrodes; each++) {
        const uint32_t ua = st_magnitude(st_i16(current + 2u * each));
        if (ua > allowed_ua) {
            return refuse(refusal, ST_RULE_CURRENT, ST_NOTHING, each, ua, allowed_ua);
        }
        board->config.passed_pc[each] += ua * width_us;
    }
    if (all_ua / 2u > board->limits.total_ua) {
        return refuse(refusal, ST_RULE_TOTAL, ST_NOTHING, ST_NOTHING, all_ua / 2u,
                      board->limits.total_ua);
    }
    return true;
}

static bool intensity_obeys(const st_board *board, const st_sequence *sequence,
                            const peaks *most, st_refusal *refusal)
{
    const st_limits *limits = &board->limits;
    const uint64_t strongest_ua = (uint64_t)limits->full_ua + limits->rounding_ua;
    uint64_t allowed_ua = (uint64_t)limits->full_ua * sequence->intensity / ST_FULL
                          + limits->rounding_ua;
    if (limits->full_us != 0u) {
        const uint64_t allowed_pc =
            strongest_ua * limits->full_us * 1001u * sequence->intensity / (1000u * ST_FULL);
        if (most->peak_pc > allowed_pc) {
            return refuse(refusal, ST_RULE_INTENSITY, ST_NOTHING, ST_NOTHING, most->peak_pc,
                          allowed_pc);
        }
        allowed_ua = strongest_ua;
    }
    if (most->peak_ua > allowed_ua) {
        return refuse(refusal, ST_RULE_INTENSITY, ST_NOTHING, ST_NOTHING, most->peak_ua,
                      allowed_ua);
    }
    return true;
}

bool st_obeys(st_board *board, const st_sequence *sequence, uint64_t now_us, st_refusal *refusal)
{
    const st_config *config = &board->config;
    const uint32_t period_us = sequence->period_us;
    peaks most = { 0, 0 };
    st_place place;
    if (!board->limits.given) {
        return refuse(refusal, ST_RULE_LIMITS, ST_NOTHING, ST_NOTHING, 0, 0);
    }
    if (sequence->slots > config->most_slots) {
        return refuse(refusal, ST_RULE_SLOTS, ST_NOTHING, ST_NOTHING, sequence->slots,
                      config->most_slots);
    }
    if (period_us < board->limits.period_us) {
        return refuse(refusal, ST_RULE_PERIOD, ST_NOTHING, ST_NOTHING, period_us,
                      board->limits.period_us);
    }
    if (!times_obey(board, sequence, refusal)) {
        return false;
    }
    memset(config->passed_pc, 0, config->electrodes * sizeof *config->passed_pc);
    st_first_slot(sequence, &place);
    while (place.slot < sequence->slots) {
        if (!slot_obeys(board, sequence, &place, &most, refusal)) {
            return false;
        }
        st_next_slot(sequence, &place, config->electrodes);
    }
    if ((sequence->flags & 2u) != 0u && !recharge_obeys(board, sequence, refusal)) {
        return false;
    }
    const uint32_t allowed_pc = ST_MAX_MEAN_UA * least(period_us, ST_BURST_US);
    for (uint32_t each = 0; each < config->electrodes; each++) {
        if (config->passed_pc[each] > allowed_pc) {
            return refuse(refusal, ST_RULE_MEAN, ST_NOTHING, each, config->passed_pc[each],
                          allowed_pc);
        }
    }
    if (!intensity_obeys(board, sequence, &most, refusal)) {
        return false;
    }
    const uint32_t allowed = st_rise_allowed(board, now_us);
    if (sequence->intensity > allowed) {
        return refuse(refusal, ST_RULE_RISE, ST_NOTHING, ST_NOTHING, sequence->intensity, allowed);
    }
    return true;
}
