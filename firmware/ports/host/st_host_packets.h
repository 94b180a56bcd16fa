/* A host in C, for programs that test the core: packets that are right but for their payload. */
#ifndef ST_TALK_H
#define ST_TALK_H

#include <string.h>

#include "st_inside.h"

typedef struct {
    uint32_t number; /* of the last packet */
    uint64_t session;
} st_talk;

/* Send a packet. */
static inline void st_talk_say(st_talk *talk, st_board *board, uint8_t kind, uint32_t about,
                               const uint8_t *payload, size_t size)
{
    static uint8_t body[70000];
    static uint8_t coded[70600];
    if (size > 65000u) {
        return;
    }
    talk->number++;
    const uint32_t words[5] = { talk->number, (uint32_t)talk->session,
                                (uint32_t)(talk->session >> 32), board->session.said, about };
    body[0] = ST_VERSION;
    body[1] = kind;
    body[6] = 0;
    for (unsigned word = 0; word < 5u; word++) {
        (void)st_put_u32(body + (word == 0u ? 2u : 3u + 4u * word), words[word]);
    }
    if (size > 0u) {
        memcpy(body + ST_HEAD_BYTES, payload, size);
    }
    size_t end = ST_HEAD_BYTES + size;
    (void)st_put_u32(body + end, st_crc32(0, body, end));
    end += 4u;
    size_t code = 0;
    size_t out = 1;
    for (size_t at = 0; at < end; at++) {
        if (body[at] != 0u) {
            coded[out++] = body[at];
        }
        if (body[at] == 0u || out - code == 0xFFu) {
            coded[code] = (uint8_t)(out - code);
            code = out++;
        }
    }
    coded[code] = (uint8_t)(out - code);
    coded[out++] = 0;
    st_feed(board, coded, out);
}

/* Begin a session whose lower half is given. */
static inline void st_talk_begin(st_talk *talk, st_board *board, uint32_t half)
{
    talk->session = half;
    talk->number = 0;
    st_talk_say(talk, board, ST_HELLO, 0, NULL, 0);
    talk->session |= (uint64_t)board->session.challenge << 32;
    st_talk_say(talk, board, ST_BEGIN, 0, NULL, 0);
}

/* Give limits that allow much. */
static inline void st_talk_limits(st_talk *talk, st_board *board)
{
    static const uint8_t head[28] = { 0x88, 0x13, 0, 0, 0x10, 0x27, 0, 0, 200, 0, 0x88, 0x13, 4, 0,
                                      0, 0, 0xF4, 1, 0x10, 0x0E, 0x40, 0x77, 0x1B, 0, 80 };
    static uint8_t payload[28u + 8u * 64u];
    const uint32_t electrodes = board->config.electrodes;
    memcpy(payload, head, sizeof head);
    memset(payload + 28, 0x20, 4u * electrodes);
    memset(payload + 28u + 4u * electrodes, 0x07, 4u * electrodes);
    st_talk_say(talk, board, ST_LIMITS, 0, payload, 28u + 8u * electrodes);
}

#endif
