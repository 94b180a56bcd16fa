/* Rules that every sequence is checked by, whatever the host has proved. */
#include <string.h>

#include "st_inside.h"

typedef struct {
    uint32_t peak_ua, peak_pc;
} peaks;

/* Check rules 4 to 7: width, discharge, fit, duty; note the times of the sequence. */
static bool times_obey(const st_board *board, st_sequence *sequence, st_refusal *refusal)
{
    const st_limits *limits = &board->limits;
    const bool recharges = (sequence->flags & ST_RECHARGES) != 0u;
    const uint64_t before_us = st_goes_on(sequence) ? board->scan.busy_us : 0u;
    const uint64_t flowed_us = st_goes_on(sequence) ? board->scan.flowing_us : 0u;
    /* A short of the least length follows a recharge phase, too. */
    uint64_t busy_us = before_us + (recharges ? sequence->recharge_us + ST_MIN_DISCHARGE_US : 0u);
    uint64_t current_us = flowed_us + sequence->recharge_us;
    st_place place;
    st_first_slot(sequence, &place);
    while (place.slot < sequence->slots) {
        const uint32_t width_us = st_shape_width(sequence, place.shape);
        const uint32_t discharge_us = st_shape_discharge(sequence, place.shape);
        if (width_us == 0u || width_us > limits->width_us) {
            return st_refuse(refusal, ST_RULE_WIDTH, place.slot, ST_NOTHING, width_us,
                             limits->width_us);
        }
        if (discharge_us < ST_MIN_DISCHARGE_US) {
            return st_refuse(refusal, ST_RULE_DISCHARGE, place.slot, ST_NOTHING, discharge_us,
                             ST_MIN_DISCHARGE_US);
        }
        busy_us += width_us + discharge_us;
        current_us += width_us;
        st_next_slot(sequence, &place, board->config.electrodes);
    }
    if (busy_us > sequence->period_us) {
        return st_refuse(refusal, ST_RULE_FIT, ST_NOTHING, ST_NOTHING, busy_us,
                         sequence->period_us);
    }
    const uint64_t allowed = (uint64_t)sequence->period_us * limits->duty_percent;
    if (100u * current_us > allowed) {
        return st_refuse(refusal, ST_RULE_DUTY, ST_NOTHING, ST_NOTHING, current_us, allowed / 100u);
    }
    sequence->busy_us = (uint32_t)(busy_us - before_us);
    sequence->flowing_us = (uint32_t)(current_us - flowed_us);
    return true;
}

/* Check rules 9 and 10 of a slot: its kernels and the sum of their amplitudes. */
static bool kernels_obey(const st_board *board, const st_sequence *sequence,
                         const st_place *place, st_refusal *refusal)
{
    const uint8_t *pairs = sequence->data + place->at;
    const uint32_t count = board->keep.whole ? board->keep.count : 0u;
    uint64_t total = 0;
    for (uint32_t index = 0; index < place->pairs; index++) {
        const uint32_t kernel = st_u16(pairs + 4u * index);
        if (kernel >= count) {
            return st_refuse(refusal, ST_RULE_KERNEL, place->slot, ST_NOTHING, kernel, count);
        }
        total += st_u16(pairs + 4u * index + 2u);
    }
    if (total > ST_FULL) {
        return st_refuse(refusal, ST_RULE_SUM, place->slot, ST_NOTHING, total, ST_FULL);
    }
    return true;
}

/* Check that nothing is above an electrode's limit; add up the load of the pass. One source has its
 * share for each of both poles; it may find one electrode alone on the skin. */
static bool each_obeys(st_board *board, st_sequence *sequence, uint32_t slot, uint32_t width_us,
                       const uint32_t share[2], uint32_t total_ua, peaks *most,
                       st_refusal *refusal)
{
    const uint32_t electrodes = board->config.electrodes;
    const int16_t *current_ua = board->config.current_ua;
    uint32_t strongest_ua = 0;
    for (uint32_t index = 0; index < electrodes; index++) {
        const st_electrode *each = &board->config.each[index];
        st_load *load = st_load_of(board, sequence, index);
        const bool cathodic = current_ua[index] > 0;
        uint32_t ua = st_magnitude(current_ua[index]);
        if (share != NULL && ua != 0u) {
            ua = share[cathodic ? 0 : 1];
        }
        if (ua > each->limit_ua) {
            return st_refuse(refusal, ST_RULE_CURRENT, slot, index, ua, each->limit_ua);
        }
        const uint32_t charge_pc = ua * width_us;
        strongest_ua = ua > strongest_ua ? ua : strongest_ua;
        load->charge_pc += charge_pc;
        load->net_pc += cathodic ? (int64_t)charge_pc : -(int64_t)charge_pc;
        load->felt += ua != 0u && ua >= each->felt_ua ? 1u : 0u;
    }
    if (total_ua > board->limits.total_ua) {
        return st_refuse(refusal, ST_RULE_TOTAL, slot, ST_NOTHING, total_ua,
                         board->limits.total_ua);
    }
    for (uint32_t index = 0; index < electrodes; index++) {
        const uint32_t ua = share != NULL && current_ua[index] != 0
                                ? total_ua : st_magnitude(current_ua[index]);
        if (ua * width_us > board->config.each[index].limit_pc) {
            return st_refuse(refusal, ST_RULE_CHARGE, slot, index, ua * width_us,
                             board->config.each[index].limit_pc);
        }
    }
    most->peak_ua = strongest_ua > most->peak_ua ? strongest_ua : most->peak_ua;
    most->peak_pc =
        strongest_ua * width_us > most->peak_pc ? strongest_ua * width_us : most->peak_pc;
    return true;
}

/* What a slot's currents or states amount to. */
typedef struct {
    int32_t net_ua;
    uint32_t all_ua, poles[2];
    bool wrong; /* a state that these outputs do not have */
    uint16_t source_ua;
} slot_sum;

/* Compute a slot as for its pulse. */
static void add_slot(st_board *board, const st_sequence *sequence, const st_place *place,
                     slot_sum *sum)
{
    const int16_t *current_ua = board->config.current_ua;
    (void)memset(sum, 0, sizeof *sum);
    (void)st_slot_currents(board, sequence, place, board->config.current_ua, &sum->source_ua);
    for (uint32_t each = 0; each < board->config.electrodes; each++) {
        const int16_t ua = current_ua[each];
        sum->net_ua += ua;
        sum->all_ua += st_magnitude(ua);
        sum->poles[0] += ua > 0 ? 1u : 0u;
        sum->poles[1] += ua < 0 ? 1u : 0u;
        sum->wrong = sum->wrong || ua == 2
                     || (ua == 0 && board->config.output == ST_ONE_AGAINST_ALL);
    }
}

/* Check that the slot is ready when the one before it is over: what it takes to compute, the least
 * of a few times, and what a pulse takes the port at least. */
static bool ready_in_time(st_board *board, const st_sequence *sequence, const st_place *place,
                          uint64_t took_us, uint32_t slot_us, st_refusal *refusal)
{
    const uint32_t port_us = board->port_us == UINT32_MAX ? 0u : board->port_us;
    for (unsigned again = 0; again < 2u && took_us + port_us > slot_us; again++) {
        slot_sum sum;
        const uint64_t from_us = st_clock(board);
        add_slot(board, sequence, place, &sum);
        const uint64_t again_us = st_clock(board) - from_us;
        took_us = again_us < took_us ? again_us : took_us;
    }
    if (took_us + port_us > slot_us) {
        return st_refuse(refusal, ST_RULE_READY, place->slot, ST_NOTHING, took_us + port_us,
                         slot_us);
    }
    return true;
}

/* Check one slot, after one that takes slot_us; add up its load. */
static bool slot_obeys(st_board *board, st_sequence *sequence, const st_place *place,
                       uint32_t slot_us, peaks *most, st_refusal *refusal)
{
    const uint32_t width_us = st_shape_width(sequence, place->shape);
    slot_sum sum;
    if ((place->kind == ST_STATES) != (board->config.output != ST_WEIGHTED)) {
        return st_refuse(refusal, ST_RULE_KIND, place->slot, ST_NOTHING, place->kind, 0);
    }
    if (place->kind <= ST_SUM && !kernels_obey(board, sequence, place, refusal)) {
        return false;
    }
    const uint64_t from_us = st_clock(board);
    add_slot(board, sequence, place, &sum);
    const uint64_t took_us = st_clock(board) - from_us;
    if (board->config.output == ST_WEIGHTED) {
        if (sum.net_ua != 0) {
            (void)st_refuse(refusal, ST_RULE_BALANCE, place->slot, ST_NOTHING, 0, 0);
            refusal->value = sum.net_ua;
            return false;
        }
        return each_obeys(board, sequence, place->slot, width_us, NULL, sum.all_ua / 2u, most,
                          refusal)
               && ready_in_time(board, sequence, place, took_us, slot_us, refusal);
    }
    if (sum.wrong || sum.poles[0] == 0u || sum.poles[1] == 0u
        || (board->config.output == ST_ONE_AGAINST_ALL
            && st_least(sum.poles[0], sum.poles[1]) != 1u)) {
        return st_refuse(refusal, ST_RULE_STATES, place->slot, ST_NOTHING, 0, 0);
    }
    /* What one source splits equally, rounded up. */
    const uint32_t share[2] = {
        (uint32_t)st_upward(sum.source_ua, sum.poles[0]),
        (uint32_t)st_upward(sum.source_ua, sum.poles[1])
    };
    return each_obeys(board, sequence, place->slot, width_us, share, sum.source_ua, most, refusal)
           && ready_in_time(board, sequence, place, took_us, slot_us, refusal);
}

/* Return a number without its sign. */
static uint64_t magnitude(int64_t value)
{
    return (uint64_t)(value < 0 ? -value : value);
}

/* Check that a recharge phase takes back charge of the session, in the first pass and the last. */
static bool recharge_takes_back(st_board *board, const st_sequence *sequence, st_refusal *refusal)
{
    const uint32_t electrodes = board->config.electrodes;
    const uint8_t *current = sequence->data + sequence->body_at - 2u * electrodes;
    const int64_t passes = (int64_t)sequence->times - 1;
    for (unsigned pass = 0; pass < 2u; pass++) {
        for (uint32_t index = 0; index < electrodes; index++) {
            const int64_t back_pc = (int64_t)st_i16(current + 2u * index) * sequence->recharge_us;
            const int64_t slots_pc = st_load_of(board, sequence, index)->net_pc;
            const int64_t before_pc = board->config.each[index].net_pc + slots_pc
                                      + (pass == 0u ? 0 : passes * (slots_pc + back_pc));
            const uint64_t most_pc = magnitude(before_pc);
            const uint64_t allowed_pc = most_pc > ST_LOST_PC ? most_pc : ST_LOST_PC;
            if (magnitude(before_pc + back_pc) > allowed_pc) {
                return st_refuse(refusal, ST_RULE_RECHARGE, ST_NOTHING, index,
                                 magnitude(before_pc + back_pc), allowed_pc);
            }
        }
    }
    return true;
}

/* Check a recharge phase, and add its load. */
static bool recharge_obeys(st_board *board, const st_sequence *sequence, st_refusal *refusal)
{
    const uint32_t electrodes = board->config.electrodes;
    const uint32_t width_us = sequence->recharge_us;
    const uint8_t *current = sequence->data + sequence->body_at - 2u * electrodes;
    int32_t net_ua = 0;
    uint32_t all_ua = 0;
    if (sequence->slots == 0u || width_us == 0u || width_us > ST_MAX_RECHARGE_US) {
        return st_refuse(refusal, ST_RULE_RECHARGE, ST_NOTHING, ST_NOTHING, width_us,
                         ST_MAX_RECHARGE_US);
    }
    for (uint32_t each = 0; each < electrodes; each++) {
        net_ua += st_i16(current + 2u * each);
        all_ua += st_magnitude(st_i16(current + 2u * each));
    }
    if (net_ua != 0) {
        (void)st_refuse(refusal, ST_RULE_BALANCE, ST_NOTHING, ST_NOTHING, 0, 0);
        refusal->value = net_ua;
        return false;
    }
    const uint32_t allowed_ua = st_least(ST_MAX_RECHARGE_UA, ST_MAX_RECHARGE_PC / width_us);
    for (uint32_t each = 0; each < electrodes; each++) {
        const uint32_t ua = st_magnitude(st_i16(current + 2u * each));
        const uint32_t most_ua = st_least(allowed_ua, board->config.each[each].limit_ua);
        if (ua > most_ua) {
            return st_refuse(refusal, ST_RULE_CURRENT, ST_NOTHING, each, ua, most_ua);
        }
    }
    if (all_ua / 2u > board->limits.total_ua) {
        return st_refuse(refusal, ST_RULE_TOTAL, ST_NOTHING, ST_NOTHING, all_ua / 2u,
                         board->limits.total_ua);
    }
    if (!recharge_takes_back(board, sequence, refusal)) {
        return false;
    }
    for (uint32_t each = 0; each < electrodes; each++) {
        const int16_t ua = st_i16(current + 2u * each);
        st_load *load = st_load_of(board, sequence, each);
        load->charge_pc += st_magnitude(ua) * width_us;
        load->net_pc += (int64_t)ua * width_us;
    }
    return true;
}

/* Check rule 17: the strongest pulse against the stated intensity. */
static bool intensity_obeys(const st_board *board, const st_sequence *sequence,
                            const peaks *most, st_refusal *refusal)
{
    const st_limits *limits = &board->limits;
    const uint64_t allowed_ua = (uint64_t)limits->full_ua * sequence->intensity / ST_FULL
                                + limits->rounding_ua;
    if (most->peak_ua > allowed_ua) {
        return st_refuse(refusal, ST_RULE_INTENSITY, ST_NOTHING, ST_NOTHING, most->peak_ua,
                         allowed_ua);
    }
    return true;
}

/* Check rule 16: charge of a period, with that of the parts before. */
static bool mean_obeys(const st_board *board, const st_sequence *sequence, uint32_t allowed_pc,
                       st_refusal *refusal)
{
    for (uint32_t each = 0; each < board->config.electrodes; each++) {
        const uint32_t before_pc = st_goes_on(sequence) ? board->config.each[each].scan_pc : 0u;
        const uint32_t charge_pc = before_pc + st_load_of(board, sequence, each)->charge_pc;
        if (charge_pc > allowed_pc) {
            return st_refuse(refusal, ST_RULE_MEAN, ST_NOTHING, each, charge_pc, allowed_pc);
        }
    }
    return true;
}

/* Check rule 20: felt pulses of a period. */
static bool felt_obeys(const st_board *board, const st_sequence *sequence, uint32_t burst_us,
                       st_refusal *refusal)
{
    const uint32_t allowed = ST_MAX_FELT_HZ * burst_us;
    for (uint32_t each = 0; each < board->config.electrodes; each++) {
        const uint32_t before = st_goes_on(sequence) ? board->config.each[each].scan_felt : 0u;
        const uint32_t felt = before + st_load_of(board, sequence, each)->felt;
        if (1000000u * (uint64_t)felt > allowed) {
            return st_refuse(refusal, ST_RULE_PERIOD_PULSES, ST_NOTHING, each, felt,
                             allowed / 1000000u);
        }
    }
    return true;
}

/* Check all rules; computes every slot in the board's scratch memory, and lets pulses that are due
 * begin meanwhile. */
bool st_obeys(st_board *board, st_sequence *sequence, uint64_t start_us, st_refusal *refusal)
{
    const st_config *config = &board->config;
    const uint32_t period_us = sequence->period_us;
    peaks most = { 0, 0 };
    st_place place;
    if (!board->limits.given) {
        return st_refuse(refusal, ST_RULE_LIMITS, ST_NOTHING, ST_NOTHING, 0, 0);
    }
    if (st_goes_on(sequence)
        && (!board->scan.open || board->scan.period_us != sequence->period_us
            || board->scan.intensity != sequence->intensity)) {
        return st_refuse(refusal, ST_RULE_PART, ST_NOTHING, ST_NOTHING, 0, 0);
    }
    if (sequence->slots > config->most_slots) {
        return st_refuse(refusal, ST_RULE_SLOTS, ST_NOTHING, ST_NOTHING, sequence->slots,
                         config->most_slots);
    }
    if (period_us < board->limits.period_us) {
        return st_refuse(refusal, ST_RULE_PERIOD, ST_NOTHING, ST_NOTHING, period_us,
                         board->limits.period_us);
    }
    if (!times_obey(board, sequence, refusal)) {
        return false;
    }
    for (uint32_t each = 0; each < config->electrodes; each++) {
        *st_load_of(board, sequence, each) = (st_load){ 0, 0, 0 };
    }
    st_first_slot(sequence, &place);
    /* Before the first slot there is what is left of the period, and as much as it takes. */
    uint32_t slot_us = UINT32_MAX;
    while (place.slot < sequence->slots) {
        if (!slot_obeys(board, sequence, &place, slot_us, &most, refusal)) {
            return false;
        }
        /* Pulses go on meanwhile. */
        st_execute_pulses(board);
        slot_us = (uint32_t)st_shape_width(sequence, place.shape)
                  + st_shape_discharge(sequence, place.shape);
        st_next_slot(sequence, &place, config->electrodes);
    }
    if ((sequence->flags & ST_RECHARGES) != 0u && !recharge_obeys(board, sequence, refusal)) {
        return false;
    }
    const uint32_t burst_us = st_least(period_us, ST_BURST_US);
    if (!mean_obeys(board, sequence, ST_MAX_MEAN_UA * burst_us, refusal)
        || !felt_obeys(board, sequence, burst_us, refusal)
        || !intensity_obeys(board, sequence, &most, refusal)) {
        return false;
    }
    const uint32_t allowed = st_rise_allowed(board, sequence, start_us);
    sequence->peak_pc = most.peak_pc;
    if (st_goes_on(sequence) && board->scan.peak_pc > most.peak_pc) {
        sequence->peak_pc = board->scan.peak_pc;
    }
    sequence->strength = st_strength(&board->limits, sequence->intensity, sequence->peak_pc);
    if (sequence->strength > allowed) {
        return st_refuse(refusal, ST_RULE_RISE, ST_NOTHING, ST_NOTHING, sequence->strength,
                         allowed);
    }
    return st_exposure_obeys(board, sequence, start_us, refusal);
}

/* Note a sequence that will flow: to the rules the parts of a scan are one sequence. */
void st_scan_note(st_board *board, const st_sequence *sequence, uint64_t start_us)
{
    st_scan *scan = &board->scan;
    const bool goes_on = st_goes_on(sequence);
    if (goes_on) {
        board->ramp = scan->before;
    } else {
        (void)memset(scan, 0, sizeof *scan);
        scan->before = board->ramp;
        scan->start_us = start_us;
        scan->period_us = sequence->period_us;
        scan->intensity = sequence->intensity;
    }
    scan->open = (sequence->flags & ST_MORE) != 0u;
    scan->busy_us += sequence->busy_us;
    scan->flowing_us += sequence->flowing_us;
    scan->peak_pc = sequence->peak_pc;
    for (uint32_t index = 0; index < board->config.electrodes; index++) {
        st_electrode *each = &board->config.each[index];
        const st_load *load = st_load_of(board, sequence, index);
        each->scan_pc = (goes_on ? each->scan_pc : 0u) + load->charge_pc;
        each->scan_felt = (uint16_t)((goes_on ? each->scan_felt : 0u) + load->felt);
    }
    st_rise_note(board, sequence, scan->start_us);
}
