/* What an electrode has had in the last second and in the session, and what it may still have.
 *
 * The last second is kept in buckets of 50 ms. Its beginning lies somewhere within the first of
 * them, which counts whole: up to 1.05 s, so that a little more is refused, and never less. For
 * net charge a bucket also keeps the largest and least sum of what ended last within it, since
 * any part of the past may be a whole second's when nothing follows.
 */
#include <string.h>

#include "st_inside.h"

#define SECOND_US 1000000u

/* Return where the load of a pass of a sequence on an electrode is kept. */
st_load *st_load_of(const st_board *board, const st_sequence *sequence, uint32_t electrode)
{
    return &board->config.each[electrode].load[sequence == &board->sequence[0] ? 0 : 1];
}

/* -- books --------------------------------------------------------------------------------- */

/* Set time and charge of the session to zero; the last second stays. */
void st_exposure_begin_session(st_board *board)
{
    board->exposure.flowing_us = 0;
    for (uint32_t each = 0; each < board->config.electrodes; each++) {
        board->config.each[each].net_pc = 0;
        board->config.each[each].session_pc = 0;
    }
}

/* Return the largest charge of either sign through an electrode in the session. */
uint64_t st_exposure_most_pc(const st_board *board)
{
    uint64_t most_pc = 0;
    for (uint32_t each = 0; each < board->config.electrodes; each++) {
        const uint64_t pc = board->config.each[each].session_pc;
        most_pc = pc > most_pc ? pc : most_pc;
    }
    return most_pc;
}

/* Empty the buckets between the newest and a later one. */
static void advance(st_board *board, uint64_t bucket)
{
    st_exposure *exposure = &board->exposure;
    if (bucket > exposure->bucket + ST_BUCKETS) {
        exposure->bucket = bucket - ST_BUCKETS;
    }
    while (exposure->bucket < bucket) {
        exposure->bucket++;
        const size_t at = (size_t)(exposure->bucket % ST_BUCKETS);
        for (uint32_t index = 0; index < board->config.electrodes; index++) {
            st_electrode *each = &board->config.each[index];
            each->charge_pc[at] = 0;
            each->sum_pc[at] = each->most_pc[at] = each->least_pc[at] = 0;
            each->felt[at] = 0;
        }
    }
}

/* The sums of an electrode over the buckets from one on, and what follows them. */
typedef struct {
    uint64_t charge_pc;
    int64_t most_pc, least_pc; /* of all net sums that end now */
    uint32_t felt;
} second;

/* Return what an electrode has had from a bucket on, with the pass at hand. */
static second second_of(const st_board *board, const st_electrode *each, uint64_t oldest,
                        const st_load *running)
{
    const uint64_t newest = board->exposure.bucket;
    const uint64_t first =
        oldest + ST_BUCKETS > newest ? oldest : newest + 1u - ST_BUCKETS;
    second found = { 0, 0, 0, 0 };
    int64_t after_pc = 0;
    if (running != NULL) {
        found.charge_pc = running->charge_pc;
        found.felt = running->felt;
        after_pc = running->net_pc;
        found.most_pc = after_pc > 0 ? after_pc : 0;
        found.least_pc = after_pc < 0 ? after_pc : 0;
    }
    for (uint64_t after = newest + 1u; after > first; after--) {
        const uint64_t bucket = after - 1u;
        const size_t at = (size_t)(bucket % ST_BUCKETS);
        const int64_t most_pc = after_pc + each->most_pc[at];
        const int64_t least_pc = after_pc + each->least_pc[at];
        found.most_pc = most_pc > found.most_pc ? most_pc : found.most_pc;
        found.least_pc = least_pc < found.least_pc ? least_pc : found.least_pc;
        after_pc += each->sum_pc[at];
        found.charge_pc += each->charge_pc[at];
        found.felt += each->felt[at];
    }
    return found;
}

/* Return the largest magnitude of net sums that end with a number of passes. */
static uint64_t most_net_pc(const second *before, int64_t net_pc, uint32_t passes)
{
    const int64_t own_pc = net_pc * (int64_t)passes;
    const int64_t most_pc = before->most_pc + own_pc;
    const int64_t least_pc = -(before->least_pc + own_pc);
    return (uint64_t)(most_pc > least_pc ? most_pc : least_pc);
}

/* Return the oldest bucket that counts at a time. */
static uint64_t oldest_at(uint64_t time_us)
{
    const uint64_t bucket = time_us / ST_BUCKET_US;
    return bucket < ST_BUCKETS ? 0u : bucket + 1u - ST_BUCKETS;
}

/* Enter the beginning of a pass: its start, and what it adds to the session. Start and time of a
 * scan are those of its first part. */
void st_exposure_begin(st_board *board, const st_sequence *sequence)
{
    st_exposure *exposure = &board->exposure;
    if (!st_goes_on(sequence)) {
        exposure->start_us[exposure->start_at] = sequence->start_us;
        exposure->start_at = (exposure->start_at + 1u) % ST_STARTS;
        exposure->starts += exposure->starts < ST_STARTS ? 1u : 0u;
        exposure->flowing_us += sequence->slots > 0u ? sequence->period_us : 0u;
    }
    if (sequence->slots == 0u) {
        return;
    }
    const uint64_t oldest = oldest_at(sequence->start_us);
    for (uint32_t index = 0; index < board->config.electrodes; index++) {
        st_electrode *each = &board->config.each[index];
        const st_load *load = st_load_of(board, sequence, index);
        const second before = second_of(board, each, oldest, NULL);
        const uint64_t net_pc = most_net_pc(&before, load->net_pc, 1);
        each->net_pc += load->net_pc;
        each->session_pc += load->charge_pc;
        if (net_pc > board->books.second_net_pc) {
            board->books.second_net_pc = (uint32_t)net_pc;
        }
    }
}

/* Enter the load of a pass into the bucket in which it ended. */
void st_exposure_end(st_board *board, const st_sequence *sequence, uint64_t until_us)
{
    const uint64_t end_us = sequence->next_us < until_us ? sequence->next_us : until_us;
    if (sequence->slots == 0u) {
        return;
    }
    advance(board, end_us / ST_BUCKET_US);
    const size_t at = (size_t)(board->exposure.bucket % ST_BUCKETS);
    for (uint32_t index = 0; index < board->config.electrodes; index++) {
        st_electrode *each = &board->config.each[index];
        const st_load *load = st_load_of(board, sequence, index);
        const int32_t net_pc = (int32_t)load->net_pc;
        const int32_t most_pc = each->most_pc[at] + net_pc;
        const int32_t least_pc = each->least_pc[at] + net_pc;
        each->charge_pc[at] += load->charge_pc;
        each->felt[at] = (uint16_t)(each->felt[at] + load->felt);
        each->sum_pc[at] += net_pc;
        each->most_pc[at] = most_pc > 0 ? most_pc : 0;
        each->least_pc[at] = least_pc < 0 ? least_pc : 0;
    }
}

/* -- rules --------------------------------------------------------------------------------- */

/* Find which passes of the first second begin within which bucket; return of how many. */
static uint32_t passes_by_bucket(st_board *board, const st_sequence *sequence, uint64_t start_us)
{
    const uint64_t period_us = sequence->period_us;
    const uint64_t most = st_upward(SECOND_US, period_us);
    const uint32_t passes = sequence->times < most ? sequence->times : (uint32_t)most;
    const uint64_t last_us = start_us + (passes - 1u) * period_us;
    uint32_t count = 0;
    for (uint64_t bucket = start_us / ST_BUCKET_US; bucket <= last_us / ST_BUCKET_US; bucket++) {
        const uint64_t from_us = bucket * ST_BUCKET_US;
        const uint64_t end_us = from_us + ST_BUCKET_US - 1u;
        const uint64_t first = from_us > start_us ? st_upward(from_us - start_us, period_us) : 0u;
        const uint64_t last = ((end_us < last_us ? end_us : last_us) - start_us) / period_us;
        if (first <= last) {
            board->exposure.passes[count] = (st_passes){ bucket, (uint32_t)first, (uint32_t)last };
            count++;
        }
    }
    return count;
}

/* Check rules 21 to 23 for every pass that begins within a second; uses the list of passes. */
static bool second_obeys(st_board *board, const st_sequence *sequence, uint64_t start_us,
                         st_refusal *refusal)
{
    static const uint64_t allowed[3] = { ST_MAX_FELT_HZ, ST_MAX_SECOND_PC, ST_MAX_NET_PC };
    const uint32_t groups = passes_by_bucket(board, sequence, start_us);
    uint32_t electrode[3] = { ST_NOTHING, ST_NOTHING, ST_NOTHING };
    uint64_t value[3] = { 0, 0, 0 };
    for (uint32_t index = 0; index < board->config.electrodes; index++) {
        const st_electrode *each = &board->config.each[index];
        const st_load *load = st_load_of(board, sequence, index);
        const st_load *running =
            board->running != NULL ? st_load_of(board, board->running, index) : NULL;
        uint64_t most[3] = { 0, 0, 0 };
        for (uint32_t group = 0; group < groups; group++) {
            const st_passes *passes = &board->exposure.passes[group];
            const uint64_t oldest = oldest_at(passes->bucket * ST_BUCKET_US);
            const second before = second_of(board, each, oldest, running);
            /* Sums of one sign are largest with the last pass, net ones with the first or last. */
            const uint64_t first_pc = most_net_pc(&before, load->net_pc, passes->first + 1u);
            const uint64_t last_pc = most_net_pc(&before, load->net_pc, passes->last + 1u);
            const uint64_t found[3] = {
                before.felt + (uint64_t)load->felt * (passes->last + 1u),
                before.charge_pc + (uint64_t)load->charge_pc * (passes->last + 1u),
                first_pc > last_pc ? first_pc : last_pc
            };
            for (unsigned rule = 0; rule < 3u; rule++) {
                most[rule] = found[rule] > most[rule] ? found[rule] : most[rule];
            }
        }
        for (unsigned rule = 0; rule < 3u; rule++) {
            if (most[rule] > allowed[rule] && electrode[rule] == ST_NOTHING) {
                electrode[rule] = index;
                value[rule] = most[rule];
            }
        }
    }
    for (unsigned rule = 0; rule < 3u; rule++) {
        if (electrode[rule] != ST_NOTHING) {
            return st_refuse(refusal, (uint8_t)(ST_RULE_SECOND_PULSES + rule), ST_NOTHING,
                             electrode[rule], value[rule], allowed[rule]);
        }
    }
    return true;
}

/* Count the passes that begin within a second; times are exact here. */
static bool starts_obey(const st_board *board, const st_sequence *sequence, uint64_t start_us,
                        st_refusal *refusal)
{
    const st_exposure *exposure = &board->exposure;
    const uint64_t allowed = st_upward(SECOND_US, board->limits.period_us) + 1u;
    const uint64_t most = st_upward(SECOND_US, sequence->period_us);
    const uint32_t passes = sequence->times < most ? sequence->times : (uint32_t)most;
    uint32_t before = exposure->starts;
    uint64_t value = 0;
    for (uint32_t pass = 0; pass < passes; pass++) {
        const uint64_t now_us = start_us + (uint64_t)pass * sequence->period_us;
        while (before > 0u
               && exposure->start_us[(exposure->start_at + ST_STARTS - before) % ST_STARTS]
                          + SECOND_US
                      < now_us) {
            before--;
        }
        value = before + pass + 1u > value ? before + pass + 1u : value;
    }
    if (value > allowed) {
        return st_refuse(refusal, ST_RULE_SECOND_STARTS, ST_NOTHING, ST_NOTHING, value, allowed);
    }
    return true;
}

/* Check rules 25 and 26, with all repetitions. */
static bool session_obeys(const st_board *board, const st_sequence *sequence, st_refusal *refusal)
{
    const st_limits *limits = &board->limits;
    const uint64_t own_us =
        st_goes_on(sequence) ? 0u : (uint64_t)sequence->times * sequence->period_us;
    const uint64_t flowing_us = board->exposure.flowing_us + own_us;
    if (flowing_us > (uint64_t)limits->session_s * SECOND_US) {
        return st_refuse(refusal, ST_RULE_SESSION_TIME, ST_NOTHING, ST_NOTHING,
                         st_upward(flowing_us, SECOND_US), limits->session_s);
    }
    for (uint32_t index = 0; index < board->config.electrodes; index++) {
        const st_electrode *each = &board->config.each[index];
        const st_load *load = st_load_of(board, sequence, index);
        const uint64_t pc = each->session_pc + (uint64_t)sequence->times * load->charge_pc;
        if (pc > (uint64_t)limits->session_uc * 1000000u) {
            return st_refuse(refusal, ST_RULE_SESSION_CHARGE, ST_NOTHING, index,
                             st_upward(pc, 1000000u), limits->session_uc);
        }
    }
    return true;
}

/* Check rules 21 to 26. */
bool st_exposure_obeys(st_board *board, const st_sequence *sequence, uint64_t start_us,
                       st_refusal *refusal)
{
    const bool empty = sequence->slots == 0u;
    return (empty || second_obeys(board, sequence, start_us, refusal))
           && (st_goes_on(sequence) || starts_obey(board, sequence, start_us, refusal))
           && (empty || session_obeys(board, sequence, refusal));
}
