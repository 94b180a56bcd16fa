/* The board measures itself: instructions of a slot, the deepest stack, and the least rest between
 * pulses. With -icount shift=N QEMU takes 2^N ns for an instruction; `points` are the kernels of a
 * slot. Part of st_m3.c. */
#ifndef ST_MEASURE_H
#define ST_MEASURE_H

#define FEW_SLOTS 32u
#define LOOPS 200u

static uint8_t payload[16384];

/* Write a name and numbers as a line. */
static void say_numbers(const char *what, const uint32_t *numbers, unsigned count)
{
    char text[120] = "\n";
    size_t at = 1u + strlen(what);
    memcpy(text + 1, what, at - 1u);
    for (unsigned which = 0; which < count; which++) {
        uint32_t unit = 1;
        while (numbers[which] / unit >= 10u) {
            unit *= 10u;
        }
        text[at++] = ' ';
        for (; unit > 0u; unit /= 10u) {
            text[at++] = (char)('0' + numbers[which] / unit % 10u);
        }
    }
    text[at++] = '\n';
    put(UART0, text, at);
}

/* Give the board one kernel over all electrodes, and limits, as a host would. */
static void open_board(void)
{
    uint8_t *at = kernels + 4;
    kernel_at[0] = 4;
    at[2] = 1;
    at[6] = ST_ELECTRODES & 0xFFu;
    at[7] = ST_ELECTRODES >> 8;
    for (uint32_t each = 0; each < ST_ELECTRODES; each += 2) {
        (void)st_put_u16(st_put_u16(at + 8u + 2u * each, each + 1u), 0u - (each + 1u));
    }
    board.keep.whole = true;
    board.keep.count = 1;
    board.limits = (st_limits){ 5000, 10000, 200, 5000, 100, 0, 3600, 1800000, 80, 200, true };
    for (uint32_t each = 0; each < ST_ELECTRODES; each++) {
        electrodes[each].limit_ua = 5000;
        electrodes[each].limit_pc = 500000;
        electrodes[each].felt_ua = 2500;
    }
}

/* Write a sequence whose slots are sums of one number of kernels and another in turn. */
static uint32_t write_sequence(uint32_t slots, uint32_t one, uint32_t other, uint32_t rest_us)
{
    uint8_t *at = st_put_u32(payload, slots < 4u ? 10000u : slots * (rest_us + 150u));
    at = st_put_u16(st_put_u16(at, 1), ST_FULL);
    *at++ = 0;
    *at++ = 1;
    at = st_put_u16(st_put_u16(at, 100), rest_us);
    for (uint32_t slot = 0; slot < slots; slot++) {
        const uint32_t count = slot % 2u == 0u ? one : other;
        *at++ = ST_SUM;
        *at++ = 0;
        at = st_put_u16(at, count);
        for (uint32_t pair = 0; pair < count; pair++) {
            at = st_put_u16(st_put_u16(at, 0), 100);
        }
    }
    return (uint32_t)(at - payload);
}

static void measure_instructions(void)
{
    static const uint32_t counts[5] = { 1, 2, 8, 16, 24 };
    for (unsigned which = 0; which < 5u; which++) {
        st_sequence sequence;
        st_refusal refusal;
        uint16_t source_ua = 0;
        uint32_t took[3];
        bool obeyed = true;
        for (uint32_t slots = 1; slots < 3u; slots++) {
            const uint32_t size = write_sequence(slots, counts[which], counts[which], 200);
            (void)st_read_sequence(&board, payload, size, &sequence, &refusal);
            const uint64_t from_us = now_us(NULL);
            for (unsigned turn = 0; turn < LOOPS; turn++) {
                obeyed = obeyed && st_obeys(&board, &sequence, 1000000u, &refusal);
            }
            took[slots] = (uint32_t)(now_us(NULL) - from_us);
        }
        st_first_slot(&sequence, &sequence.place);
        const uint64_t from_us = now_us(NULL);
        for (unsigned turn = 0; turn < LOOPS; turn++) {
            (void)st_slot_currents(&board, &sequence, &sequence.place, current_ua, &source_ua);
        }
        took[0] = (uint32_t)(now_us(NULL) - from_us);
        /* Microseconds of 200 turns at a nanosecond each are fifths of an instruction of one. */
        const uint32_t numbers[4] = { counts[which], 5u * took[0], 5u * (took[2] - took[1]),
                                      5u * (2u * took[1] - took[2]) };
        say_numbers(obeyed ? "kernels, deliver, check, sequence" : "refused", numbers, 4);
    }
}

/* The least rest between the end of a pulse and the next, from the port's own clock. */
static uint64_t over_us;
static uint32_t least_us, seen;

static uint64_t watched_pulse(void *self, const st_pulse *given)
{
    const uint64_t begun_us = pulse(self, given);
    if (seen > 0u) {
        const uint32_t rest_us = (uint32_t)(begun_us > over_us ? begun_us - over_us : 0u);
        least_us = st_least(least_us, rest_us);
    }
    over_us = begun_us + given->width_us;
    seen++;
    return begun_us;
}

static void measure_rest(uint32_t one, uint32_t other, uint32_t rest_us)
{
    st_refusal refusal = { 0, 0, 0, 0, 0, 0 };
    st_sequence *sequence = &board.sequence[0];
    const uint32_t size = write_sequence(FEW_SLOTS, one, other, rest_us);
    const bool read = st_read_sequence(&board, payload, size, sequence, &refusal);
    board.heard_us = now_us(NULL);
    if (!read || !st_obeys(&board, sequence, board.heard_us, &refusal)) {
        const uint32_t numbers[6] = { one, other, rest_us, refusal.rule, refusal.slot,
                                      (uint32_t)refusal.value };
        say_numbers("refused", numbers, 6);
        return;
    }
    board.port.pulse = watched_pulse;
    board.refusing = 0;
    seen = 0;
    least_us = UINT32_MAX;
    const uint64_t from_us = now_us(NULL);
    st_begin_sequence(&board, sequence, from_us);
    while (seen < FEW_SLOTS) {
        board.heard_us = now_us(NULL);
        st_advance(&board);
    }
    const uint32_t took_us = (uint32_t)(now_us(NULL) - from_us);
    st_end_session(&board, ST_NOT_BEGUN, "end");
    const uint32_t numbers[6] = { one, other, rest_us, seen, least_us, took_us };
    say_numbers("rest", numbers, 6);
}

static void measure(void)
{
    static const uint32_t pairs[5][2] = { { 1, 1 }, { 16, 1 }, { 1, 16 }, { 24, 1 }, { 24, 24 } };
    open_board();
    measure_instructions();
    for (unsigned which = 0; which < 5u; which++) {
        for (uint32_t rest_us = 50; rest_us <= 1250u; rest_us *= 5u) {
            measure_rest(pairs[which][0], pairs[which][1], rest_us);
        }
    }
}

#endif
