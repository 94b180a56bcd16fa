/* What the board sends to its host. */
#include <string.h>

#include "st_inside.h"

/* Send the next packet of the session; uses the port's line. */
void st_send(st_board *board, uint8_t kind, uint32_t about, const uint8_t *payload, size_t size)
{
    st_session *session = &board->session;
    session->said++;
    st_send_packet(board, kind, session->number, session->said, session->taken, about, payload,
                   size);
}

/* Acknowledge the last sequence, with the time at which it began. */
void st_acknowledge(st_board *board)
{
    const uint64_t start_us = board->last_start_us;
    uint8_t payload[8];
    (void)st_put_u32(st_put_u32(payload, (uint32_t)start_us), (uint32_t)(start_us >> 32));
    st_send(board, ST_ACK, (uint32_t)board->last_number, payload, sizeof payload);
}

#define NAK_BYTES 14u

/* Write the payload of a NAK. */
static void put_refusal(uint8_t payload[NAK_BYTES], const st_refusal *refusal)
{
    payload[0] = refusal->reason;
    payload[1] = refusal->rule;
    uint8_t *at = st_put_u16(st_put_u16(payload + 2, refusal->slot), refusal->electrode);
    (void)st_put_u32(st_put_u32(at, (uint32_t)refusal->value), (uint32_t)refusal->allowed);
}

/* Send a NAK of this session. */
void st_send_refusal(st_board *board, uint32_t about, const st_refusal *refusal)
{
    uint8_t payload[NAK_BYTES];
    put_refusal(payload, refusal);
    st_send(board, ST_NAK, about, payload, sizeof payload);
}

/* Send a NAK that names a reason, and no rule. */
void st_send_reason(st_board *board, uint32_t about, uint8_t reason)
{
    const st_refusal refusal = { reason, ST_RULE_NONE, ST_NOTHING, ST_NOTHING, 0, 0 };
    st_send_refusal(board, about, &refusal);
}

/* Refuse to open a session while the emergency switch is open: the same BEGIN may come again. */
void st_refuse_begin(st_board *board, const st_message *message)
{
    const st_refusal refusal = { ST_EMERGENCY, ST_RULE_NONE, ST_NOTHING, ST_NOTHING, 0, 0 };
    uint8_t payload[NAK_BYTES];
    put_refusal(payload, &refusal);
    st_send_packet(board, ST_NAK, message->session, 0, 0, message->number, payload, sizeof payload);
}

/* Send CAPABILITIES, the answer to a HELLO of that number. */
void st_send_capabilities(st_board *board, uint64_t session, uint32_t number)
{
    const st_config *config = &board->config;
    uint8_t payload[128];
    uint8_t *at = st_put_u16(payload, config->electrodes);
    *at++ = (uint8_t)(config->output - ST_WEIGHTED);
    *at++ = config->features;
    at = st_put_u16(st_put_u16(at, ST_MAX_CURRENT_UA), config->most_slots);
    at = st_put_u16(st_put_u16(at, ST_SILENCE_US / 1000u), config->compliance_v);
    at = st_put_u32(st_put_u32(at, config->kernel_bytes), config->packet_bytes);
    at = st_put_u16(at, config->most_kernels);
    const size_t head = (size_t)(at - payload);
    size_t name = strlen(config->name);
    if (name > sizeof payload - head) {
        name = sizeof payload - head;
    }
    (void)memcpy(at, config->name, name);
    st_send_packet(board, ST_CAPABILITIES, session, 0, 0, number, payload, head + name);
}

/* Send REPORT, the answer to a STATUS of that number. */
void st_send_report(st_board *board, uint32_t about)
{
    const st_books *books = &board->books;
    uint8_t payload[53];
    uint8_t *at = st_put_u32(st_put_u32(payload, books->sequences), books->slots);
    at = st_put_u32(st_put_u32(at, (uint32_t)books->pulses), (uint32_t)(books->pulses >> 32));
    at = st_put_u32(at, books->violations);
    at = st_put_u32(st_put_u32(at, books->max_current_ua), books->max_charge_pc);
    at = st_put_u32(at, board->port.left_pc != NULL ? board->port.left_pc(board->port.self) : 0u);
    *at++ = (uint8_t)((board->running != NULL ? 1u : 0u) + (board->waiting != NULL ? 1u : 0u));
    at = st_put_u32(st_put_u32(at, books->old_packets), books->foreign_packets);
    at = st_put_u32(at, books->second_net_pc);
    at = st_put_u32(at, (uint32_t)st_upward(board->exposure.flowing_us, 1000000u));
    at = st_put_u32(at, (uint32_t)st_upward(st_exposure_most_pc(board), 1000000u));
    st_send(board, ST_REPORT, about, payload, (size_t)(at - payload));
}
