/* The engine: sequences into pulses, and books of what was delivered. */
#include <string.h>

#include "st_inside.h"

/* Read the port's clock into the board; one that goes back stands still. */
uint64_t st_clock(st_board *board)
{
    const uint64_t now_us = board->port.now_us(board->port.self);
    board->now_us = now_us > board->now_us ? now_us : board->now_us;
    return board->now_us;
}

/* Short all electrodes, enter what has flowed, drop all sequences and refuse new ones. */
void st_end_session(st_board *board, uint8_t refusing, const char *reason)
{
    board->port.shorted(board->port.self, reason);
    if (board->running != NULL) {
        st_exposure_end(board, board->running, board->executed_us);
    }
    board->running = board->waiting = NULL;
    board->ready = false;
    board->refusing = refusing;
    board->session.live = false;
}

/* What interrupts write is one pointer, read and written whole. */
bool st_may_pulse(const st_board *board)
{
    return __atomic_load_n(&board->zero_reason, __ATOMIC_SEQ_CST) == NULL;
}

/* Leave a reason for the core to find and short all electrodes; touches nothing else of the board.
 * */
void st_zero(st_board *board, const char *reason)
{
    /* Called once more before the core has seen it, also by the port's own shorted. */
    const char *why = reason != NULL ? reason : "zero";
    if (st_may_pulse(board)) {
        __atomic_store_n(&board->zero_reason, why, __ATOMIC_SEQ_CST);
        if (board->port.shorted != NULL) {
            board->port.shorted(board->port.self, why);
        }
    }
}

/* End the session if an interrupt or the switch says so; may short and send. */
bool st_may_go_on(st_board *board)
{
    const st_port *port = &board->port;
    const char *reason = __atomic_load_n(&board->zero_reason, __ATOMIC_SEQ_CST);
    if (reason != NULL) {
        st_end_session(board, ST_NOT_BEGUN, reason);
        __atomic_store_n(&board->zero_reason, NULL, __ATOMIC_SEQ_CST);
    }
    board->open = (board->config.features & ST_SWITCH) != 0u && port->emergency_open(port->self);
    if (board->open && board->refusing == 0u) {
        st_end_session(board, ST_EMERGENCY, "emergency");
        st_send_reason(board, 0, ST_EMERGENCY);
    }
    return board->refusing == 0u;
}

/* Write the currents of a recharge phase. */
static void read_recharge(const st_board *board, const st_sequence *sequence, int16_t *current_ua)
{
    const uint32_t electrodes = board->config.electrodes;
    const uint8_t *current = sequence->data + sequence->body_at - 2u * electrodes;
    for (uint32_t each = 0; each < electrodes; each++) {
        current_ua[each] = st_i16(current + 2u * each);
    }
}

/* Note of the next pulse what goes into the books once it has begun. */
static void count_next(st_board *board)
{
    const st_pulse *pulse = &board->next;
    uint32_t strongest_ua = 0;
    uint32_t poles[2] = { 0, 0 };
    for (uint32_t each = 0; each < board->config.electrodes; each++) {
        const int16_t ua = pulse->current_ua[each];
        const uint32_t magnitude = st_magnitude(ua);
        poles[0] += ua > 0 ? 1u : 0u;
        poles[1] += ua < 0 ? 1u : 0u;
        strongest_ua = magnitude > strongest_ua ? magnitude : strongest_ua;
    }
    board->next_poles = poles[0] + poles[1];
    if (board->config.output != ST_WEIGHTED) {
        const uint32_t fewest = poles[0] < poles[1] ? poles[0] : poles[1];
        strongest_ua = (pulse->source_ua + fewest - 1u) / (fewest > 0u ? fewest : 1u);
        board->next_poles = pulse->source_ua > 0u ? board->next_poles : 0u;
    }
    board->next_ua = strongest_ua;
}

/* Compute the next pulse of the sequence at hand, if there is one: before its time, so that nothing
 * stands between the clock and the pulse. */
static void prepare(st_board *board, const st_sequence *sequence)
{
    const st_place *place = &sequence->place;
    st_pulse *pulse = &board->next;
    (void)memset(pulse, 0, sizeof *pulse);
    pulse->number = sequence->number;
    pulse->current_ua = board->config.pulse_ua;
    board->ready = true;
    if (place->slot < sequence->slots) {
        pulse->slot = (uint16_t)place->slot;
        pulse->width_us = st_shape_width(sequence, place->shape);
        pulse->rest_us = st_shape_discharge(sequence, place->shape);
        pulse->site = st_slot_currents(board, sequence, place, board->config.pulse_ua,
                                       &pulse->source_ua);
        count_next(board);
    } else if (!sequence->recharged) {
        pulse->slot = pulse->site = ST_NOTHING;
        pulse->width_us = sequence->recharge_us;
        read_recharge(board, sequence, board->config.pulse_ua);
    } else {
        board->ready = false;
    }
}

/* Begin a pass of a sequence; nothing of it flows yet. */
static void start_scan(st_board *board, st_sequence *sequence, uint64_t start_us)
{
    sequence->start_us = sequence->next_us = start_us;
    sequence->end_us = start_us + sequence->period_us;
    if (st_goes_on(sequence)) {
        /* The period is that of the scan; what comes late ends late. */
        sequence->end_us = board->scan.end_us > start_us ? board->scan.end_us : start_us;
    }
    sequence->recharged = (sequence->flags & ST_RECHARGES) == 0u;
    sequence->measured = 0;
    st_first_slot(sequence, &sequence->place);
    st_exposure_begin(board, sequence);
    prepare(board, sequence);
}

/* Begin a sequence that obeys all rules, and acknowledge it. */
void st_begin_sequence(st_board *board, st_sequence *sequence, uint64_t start_us)
{
    board->running = sequence;
    start_scan(board, sequence, start_us);
    board->last_number = sequence->number;
    board->last_begun = true;
    board->last_start_us = start_us;
    st_acknowledge(board);
}

/* Enter the pulse that has begun into the books. */
static void note_pulse(st_board *board)
{
    st_books *books = &board->books;
    const uint32_t charge_pc = board->next_ua * board->next.width_us;
    if (board->next.slot == ST_NOTHING) {
        books->recharges++;
        return;
    }
    books->slots++;
    books->pulses += board->next_poles;
    books->max_current_ua =
        board->next_ua > books->max_current_ua ? board->next_ua : books->max_current_ua;
    books->max_charge_pc = charge_pc > books->max_charge_pc ? charge_pc : books->max_charge_pc;
}

/* Note the voltage of the slot before, whose pulse is over; uses the port's voltmeter. */
static void note_volts(st_board *board, st_sequence *sequence)
{
    if ((sequence->flags & ST_MEASURES) != 0u && (board->config.features & ST_VOLTAGE) != 0u
        && sequence->measured < sequence->place.slot) {
        const uint16_t volts = board->port.volts(board->port.self);
        (void)st_put_u16(board->config.volts + 2u * sequence->measured, volts);
        sequence->measured++;
    }
}

/* Move the times of a sequence to a pulse that has begun. What was missed is not made up for: a
 * scan that begins late ends late, but for the little that keeps the rate. */
static void move_to(st_board *board, st_sequence *sequence, uint64_t begun_us)
{
    st_pulse *pulse = &board->next;
    if (!st_is_played(board) && pulse->slot == 0u && !st_goes_on(sequence)
        && begun_us > sequence->start_us + sequence->period_us / 4u) {
        sequence->end_us = begun_us + sequence->period_us;
    }
    sequence->next_us = begun_us + pulse->width_us + pulse->rest_us;
    if (sequence->next_us > sequence->end_us) {
        sequence->end_us = sequence->next_us;
    }
}

/* Begin the next pulse, and compute the one after it; return false if none may begin. */
static bool deliver(st_board *board, st_sequence *sequence)
{
    st_pulse *pulse = &board->next;
    note_volts(board, sequence);
    if (!st_may_go_on(board)) {
        return false;
    }
    pulse->start_us = sequence->next_us;
    if (pulse->slot == ST_NOTHING && pulse->start_us + pulse->width_us < sequence->end_us) {
        pulse->rest_us = (uint32_t)(sequence->end_us - pulse->start_us) - pulse->width_us;
    }
    /* All is ready: the clock comes last. */
    const uint64_t before_us = st_clock(board);
    if (!st_is_played(board)
        && (before_us >= board->heard_us + ST_SILENCE_US || before_us < board->free_us)) {
        return false;
    }
    uint64_t begun_us = board->port.pulse(board->port.self, pulse);
    const uint64_t took_us = st_clock(board) - before_us;
    if (begun_us < before_us && !st_is_played(board)) {
        begun_us = before_us;
    }
    if (begun_us != ST_NOT_BEGUN_US) {
        note_pulse(board);
        board->free_us = begun_us + pulse->width_us
                         + (pulse->slot == ST_NOTHING ? ST_MIN_DISCHARGE_US : pulse->rest_us);
        board->port_us = took_us < board->port_us ? (uint32_t)took_us : board->port_us;
    }
    if (!st_may_go_on(board) || begun_us == ST_NOT_BEGUN_US) {
        return false;
    }
    move_to(board, sequence, begun_us);
    if (pulse->slot == ST_NOTHING) {
        sequence->recharged = true;
    } else {
        st_next_slot(sequence, &sequence->place, board->config.electrodes);
    }
    prepare(board, sequence);
    return true;
}

/* Return when the pass at hand is over: with its slots, if the next part of its scan waits. */
uint64_t st_pass_end_us(const st_board *board)
{
    const st_sequence *waiting = board->waiting;
    const uint64_t over_us = board->running->next_us;
    if (waiting == NULL || !st_goes_on(waiting)) {
        return board->running->end_us;
    }
    /* Until it begins, its start is when it came. */
    return over_us > waiting->start_us ? over_us : waiting->start_us;
}

/* End a pass that is over; begin the next one, or the sequence that waits. */
static void end_scan(st_board *board, st_sequence *sequence)
{
    const uint64_t end_us = st_pass_end_us(board);
    note_volts(board, sequence);
    if (!st_may_go_on(board)) {
        return;
    }
    st_exposure_end(board, sequence, end_us);
    if ((sequence->flags & ST_MEASURES) != 0u && (board->config.features & ST_VOLTAGE) != 0u) {
        st_send(board, ST_VOLTAGES, sequence->number, board->config.volts,
                2u * (size_t)sequence->slots);
    }
    sequence->left--;
    if (sequence->left > 0u && board->waiting == NULL) {
        start_scan(board, sequence, end_us);
        return;
    }
    board->scan.end_us = sequence->end_us;
    board->books.sequences += (sequence->flags & ST_MORE) == 0u ? 1u : 0u;
    st_sequence *next = board->waiting;
    board->running = board->waiting = NULL;
    if (next != NULL) {
        st_begin_sequence(board, next, end_us);
    } else {
        board->port.shorted(board->port.self, "end");
    }
}

/* Return whether a time has come, by the clock as it is now. Once the host has been silent for too
 * long, nothing is due any more; where time is played, what was due before is. */
static bool is_due(st_board *board, uint64_t time_us)
{
    const uint64_t deadline_us = board->heard_us + ST_SILENCE_US;
    board->executed_us = st_clock(board);
    if (board->executed_us >= deadline_us) {
        if (!st_is_played(board)) {
            return false;
        }
        board->executed_us = deadline_us;
    }
    return time_us <= board->executed_us;
}

/* Begin the pulses of the pass at hand that are due by the clock. */
void st_execute_pulses(st_board *board)
{
    while (board->running != NULL && board->ready && is_due(board, board->running->next_us)) {
        if (!deliver(board, board->running)) {
            return;
        }
    }
}

/* Begin all pulses that are due, and the passes that follow one another. */
void st_execute(st_board *board)
{
    st_execute_pulses(board);
    while (board->running != NULL && !board->ready && is_due(board, st_pass_end_us(board))) {
        end_scan(board, board->running);
        st_execute_pulses(board);
    }
}
