/* The engine: sequences into pulses, and books of what was delivered. */
#include "st_inside.h"

static void start_scan(st_board *board, st_sequence *sequence, uint64_t start_us)
{
    sequence->start_us = sequence->next_us = start_us;
    sequence->end_us = start_us + sequence->period_us;
    sequence->recharged = (sequence->flags & 2u) == 0u;
    sequence->measured = 0;
    st_first_slot(sequence, &sequence->place);
    st_exposure_begin(board, sequence);
}

void st_begin_sequence(st_board *board, st_sequence *sequence, uint64_t start_us)
{
    board->running = sequence;
    start_scan(board, sequence, start_us);
    board->last_number = sequence->number;
    board->last_begun = true;
    board->last_start_us = start_us;
    st_tell_begun(board);
}

/* Add what a source drives through each electrode, in books that know nothing of the skin. */
static void note_charge(st_board *board, uint64_t width_us, uint32_t source_ua,
                        const uint32_t poles[2])
{
    for (uint32_t each = 0; each < board->config.electrodes; each++) {
        int64_t ua = board->config.current_ua[each];
        if (board->config.output != ST_WEIGHTED && ua != 0) {
            /* What one source splits equally; what is over is dropped from the product. */
            const int64_t pc = (int64_t)(source_ua * width_us / poles[ua > 0 ? 0 : 1]);
            board->config.each[each].driven_pc += ua > 0 ? pc : -pc;
        } else {
            board->config.each[each].driven_pc += ua * (int64_t)width_us;
        }
    }
}

static void note_pulse(st_board *board, uint32_t width_us, uint32_t source_ua)
{
    uint32_t strongest_ua = 0;
    uint32_t poles[2] = { 0, 0 };
    for (uint32_t each = 0; each < board->config.electrodes; each++) {
        const int16_t ua = board->config.current_ua[each];
        const uint32_t magnitude = st_magnitude(ua);
        poles[0] += ua > 0 ? 1u : 0u;
        poles[1] += ua < 0 ? 1u : 0u;
        strongest_ua = magnitude > strongest_ua ? magnitude : strongest_ua;
    }
    uint32_t flowing = poles[0] + poles[1];
    if (board->config.output != ST_WEIGHTED) {
        const uint32_t fewest = poles[0] < poles[1] ? poles[0] : poles[1];
        strongest_ua = (source_ua + fewest - 1u) / (fewest > 0u ? fewest : 1u);
        flowing = source_ua > 0u ? flowing : 0u;
    }
    st_books *books = &board->books;
    const uint32_t charge_pc = strongest_ua * width_us;
    books->slots++;
    books->pulses += flowing;
    books->max_current_ua =
        strongest_ua > books->max_current_ua ? strongest_ua : books->max_current_ua;
    books->max_charge_pc = charge_pc > books->max_charge_pc ? charge_pc : books->max_charge_pc;
    note_charge(board, width_us, source_ua, poles);
}

/* Note the voltage of the slot before, whose pulse is over. */
static void note_volts(st_board *board, st_sequence *sequence)
{
    if ((sequence->flags & 1u) != 0u && (board->config.features & ST_VOLTAGE) != 0u
        && sequence->measured < sequence->place.slot) {
        const uint16_t volts = board->port.volts(board->port.self);
        (void)st_put_u16(board->config.volts + 2u * sequence->measured, volts);
        sequence->measured++;
    }
}

static void deliver(st_board *board, st_sequence *sequence)
{
    const st_place *place = &sequence->place;
    st_pulse pulse = { 0 };
    note_volts(board, sequence);
    pulse.start_us = sequence->next_us;
    pulse.number = sequence->number;
    pulse.slot = (uint16_t)place->slot;
    pulse.width_us = st_shape_width(sequence, place->shape);
    pulse.rest_us = st_shape_discharge(sequence, place->shape);
    pulse.current_ua = board->config.current_ua;
    pulse.site = st_slot_currents(board, sequence, place, &pulse.source_ua);
    board->port.pulse(board->port.self, &pulse);
    note_pulse(board, pulse.width_us, pulse.source_ua);
    sequence->next_us += pulse.width_us + pulse.rest_us;
    if (sequence->next_us > sequence->end_us) {
        sequence->end_us = sequence->next_us;
    }
    st_next_slot(sequence, &sequence->place, board->config.electrodes);
}

static void read_recharge(st_board *board, const st_sequence *sequence)
{
    const uint32_t electrodes = board->config.electrodes;
    const uint8_t *current = sequence->data + sequence->body_at - 2u * electrodes;
    for (uint32_t each = 0; each < electrodes; each++) {
        board->config.current_ua[each] = st_i16(current + 2u * each);
    }
}

static void recharge(st_board *board, st_sequence *sequence)
{
    st_pulse pulse = { 0 };
    note_volts(board, sequence);
    read_recharge(board, sequence);
    pulse.start_us = sequence->next_us;
    pulse.number = sequence->number;
    pulse.slot = pulse.site = ST_NOTHING;
    pulse.width_us = sequence->recharge_us;
    pulse.current_ua = board->config.current_ua;
    sequence->next_us += pulse.width_us;
    if (sequence->next_us > sequence->end_us) {
        sequence->end_us = sequence->next_us;
    }
    pulse.rest_us = (uint32_t)(sequence->end_us - sequence->next_us);
    board->port.pulse(board->port.self, &pulse);
    board->books.recharges++;
    sequence->recharged = true;
}

/* Note a recharge phase, or the part of it before it was cut off. */
static void note_recharge(st_board *board, const st_sequence *sequence, uint64_t until_us)
{
    if ((sequence->flags & 2u) != 0u && sequence->recharged) {
        const uint64_t start_us = sequence->next_us - sequence->recharge_us;
        const uint64_t width_us = until_us - start_us;
        read_recharge(board, sequence);
        /* Weighted boards alone have one: nothing is split among poles. */
        note_charge(board, width_us < sequence->recharge_us ? width_us : sequence->recharge_us, 0,
                    NULL);
    }
}

void st_end_session(st_board *board, uint8_t refusing, const char *reason)
{
    board->port.shorted(board->port.self, reason);
    if (board->running != NULL) {
        note_recharge(board, board->running, board->executed_us);
        st_exposure_end(board, board->running, board->executed_us);
    }
    board->running = board->waiting = NULL;
    board->refusing = refusing;
    board->session.live = false;
}

void st_zero(st_board *board, const char *reason)
{
    st_end_session(board, ST_NOT_BEGUN, reason);
}

static void end_scan(st_board *board, st_sequence *sequence)
{
    const uint64_t end_us = sequence->end_us;
    note_volts(board, sequence);
    note_recharge(board, sequence, end_us);
    st_exposure_end(board, sequence, end_us);
    if ((sequence->flags & 1u) != 0u && (board->config.features & ST_VOLTAGE) != 0u) {
        st_tell(board, ST_VOLTAGES, sequence->number, board->config.volts,
                2u * (size_t)sequence->slots);
    }
    sequence->left--;
    if (sequence->left > 0u && board->waiting == NULL) {
        start_scan(board, sequence, end_us);
        return;
    }
    board->books.sequences++;
    st_sequence *next = board->waiting;
    board->running = board->waiting = NULL;
    if (next != NULL) {
        st_begin_sequence(board, next, end_us);
    } else {
        board->port.shorted(board->port.self, "end");
    }
}

/* Begin a slot now. What was missed is not made up for: a scan that begins late ends late, but for
 * the little that keeps the rate. */
static void put_off(st_sequence *sequence, uint64_t now_us)
{
    sequence->next_us = now_us;
    if (sequence->place.slot == 0u && now_us > sequence->start_us + sequence->period_us / 4u) {
        sequence->end_us = now_us + sequence->period_us;
    }
}

void st_execute(st_board *board, uint64_t until_us)
{
    board->executed_us = until_us;
    while (board->running != NULL) {
        st_sequence *sequence = board->running;
        while (sequence->place.slot < sequence->slots && sequence->next_us <= until_us) {
            st_look_at_switch(board);
            if (board->running == NULL) {
                return;
            }
            if (board->config.real_time) {
                put_off(sequence, until_us);
            }
            deliver(board, sequence);
        }
        const bool slots_over = sequence->place.slot == sequence->slots;
        if (slots_over && !sequence->recharged && sequence->next_us <= until_us) {
            st_look_at_switch(board);
            if (board->running == NULL) {
                return;
            }
            if (board->config.real_time) {
                sequence->next_us = until_us;
            }
            recharge(board, sequence);
        }
        if (!slots_over || !sequence->recharged || until_us < sequence->end_us) {
            return;
        }
        end_scan(board, sequence);
        if (board->config.real_time) {
            /* Answers take time: the next pulse begins by a clock that is read anew. */
            return;
        }
    }
}
