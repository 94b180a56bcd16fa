/* A sequence as it lies in a packet: read, refused, and walked slot by slot. */
#include <string.h>

#include "st_inside.h"

#define HEAD 10u
#define GROUP 4u

/* Write a refusal; return false. */
bool st_refuse(st_refusal *refusal, uint8_t rule, uint32_t slot, uint32_t electrode,
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

/* Return the bytes of one row of a group. */
static uint32_t row_bytes(uint8_t kind, uint32_t electrodes)
{
    switch (kind) {
    case ST_CURRENTS:
        return 2u + 2u * electrodes;
    case ST_STATES:
        return 4u + (electrodes + 3u) / 4u;
    default:
        return 4u;
    }
}

/* Check that a payload is exactly one sequence, and note where its parts are. */
bool st_read_sequence(const st_board *board, const uint8_t *data, uint32_t size,
                      st_sequence *sequence, st_refusal *refusal)
{
    const uint32_t electrodes = board->config.electrodes;
    (void)memset(sequence, 0, sizeof *sequence);
    refusal->reason = ST_MALFORMED;
    if (size < HEAD) {
        return false;
    }
    sequence->data = data;
    sequence->size = size;
    sequence->period_us = st_u32(data);
    sequence->times = st_u16(data + 4);
    sequence->intensity = st_u16(data + 6);
    sequence->flags = data[8];
    sequence->shapes = data[9];
    const bool recharges = (sequence->flags & ST_RECHARGES) != 0u;
    const bool part = (sequence->flags & (ST_MORE | ST_GOES_ON)) != 0u;
    if (sequence->times == 0u || sequence->flags > 15u || (part && sequence->times != 1u)
        || (recharges
            && (board->config.output != ST_WEIGHTED || (sequence->flags & ST_MORE) != 0u))) {
        return false;
    }
    uint32_t at = HEAD + 4u * sequence->shapes;
    const uint32_t recharge_bytes = recharges ? 2u + 2u * electrodes : 0u;
    if (at + recharge_bytes > size) {
        return false;
    }
    if (recharges) {
        sequence->recharge_us = st_u16(data + at);
        at += recharge_bytes;
    }
    sequence->body_at = at;
    while (at < size) {
        if (size - at < GROUP) {
            return false;
        }
        const uint8_t kind = data[at];
        const uint32_t count = st_u16(data + at + 2);
        if (kind > ST_STATES || data[at + 1] >= sequence->shapes || count == 0u) {
            return false;
        }
        at += GROUP;
        const uint32_t row = row_bytes(kind, electrodes);
        if ((size - at) / row < count) {
            return false;
        }
        at += row * count;
        sequence->slots += kind == ST_SUM ? 1u : count;
    }
    sequence->left = sequence->times;
    return !part || sequence->slots > 0u;
}

/* Enter the group at a place, if there is one. */
static void enter_group(const st_sequence *sequence, st_place *place, uint32_t at)
{
    place->at = at;
    if (at < sequence->size) {
        const uint32_t count = st_u16(sequence->data + at + 2);
        place->kind = sequence->data[at];
        place->shape = sequence->data[at + 1];
        place->at = at + GROUP;
        place->group_left = place->kind == ST_SUM ? 1u : count;
        place->pairs = place->kind == ST_SUM ? count : 1u;
    }
}

/* Go to the first slot. */
void st_first_slot(const st_sequence *sequence, st_place *place)
{
    (void)memset(place, 0, sizeof *place);
    enter_group(sequence, place, sequence->body_at);
}

/* Go to the next slot. */
void st_next_slot(const st_sequence *sequence, st_place *place, uint16_t electrodes)
{
    const uint32_t rows = place->kind == ST_SUM ? place->pairs : 1u;
    const uint32_t at = place->at + rows * row_bytes(place->kind, electrodes);
    place->slot++;
    place->group_left--;
    if (place->group_left > 0u) {
        place->at = at;
    } else {
        enter_group(sequence, place, at);
    }
}

/* Return the width of a pulse shape. */
uint16_t st_shape_width(const st_sequence *sequence, uint8_t shape)
{
    return st_u16(sequence->data + HEAD + 4u * shape);
}

/* Return the discharge of a pulse shape. */
uint16_t st_shape_discharge(const st_sequence *sequence, uint8_t shape)
{
    return st_u16(sequence->data + HEAD + 4u * shape + 2u);
}

/* Write the currents of a sum of kernels; uses the board's sums. */
static void add_up(st_board *board, const uint8_t *pairs, uint32_t count, int16_t *current_ua)
{
    const uint32_t electrodes = board->config.electrodes;
    int32_t *sums = board->config.sums;
    (void)memset(sums, 0, electrodes * sizeof *sums);
    for (uint32_t index = 0; index < count; index++) {
        st_add_kernel(board, st_u16(pairs + 4u * index), st_u16(pairs + 4u * index + 2u));
    }
    /* From electrode 0 to each one, rounded to whole microamperes, halves upward. */
    int64_t carried = 65536;
    int32_t before = 0;
    for (uint32_t each = 0; each < electrodes; each++) {
        carried += sums[each];
        /* The floor of a quotient by 2^17, for either sign. */
        const int64_t floor = carried >= 0 ? carried / 131072 : -((131071 - carried) / 131072);
        current_ua[each] = (int16_t)((int32_t)floor - before);
        before = (int32_t)floor;
    }
}

/* Write a slot's currents or states, computed from the packet's bytes; return its site. */
uint16_t st_slot_currents(st_board *board, const st_sequence *sequence, const st_place *place,
                          int16_t *current_ua, uint16_t *source_ua)
{
    const uint32_t electrodes = board->config.electrodes;
    const uint8_t *at = sequence->data + place->at;
    static const int16_t states[4] = { 0, 1, -1, 2 };
    *source_ua = 0;
    switch (place->kind) {
    case ST_CURRENTS:
        for (uint32_t each = 0; each < electrodes; each++) {
            current_ua[each] = st_i16(at + 2u + 2u * each);
        }
        return st_u16(at);
    case ST_STATES:
        *source_ua = st_u16(at + 2);
        for (uint32_t each = 0; each < electrodes; each++) {
            const uint32_t four = at[4u + each / 4u];
            current_ua[each] = states[(four >> (2u * (each % 4u))) & 3u];
        }
        return st_u16(at);
    default:
        add_up(board, at, place->pairs, current_ua);
        return st_kernel_site(board, st_u16(at));
    }
}
