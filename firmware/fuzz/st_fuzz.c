/* All that a host may send, for libFuzzer: raw bytes, and packets whose head and CRC are right.
 *
 * An input is a list of acts: a byte that says which, two that say how long, and what it takes.
 * Whatever comes, no pulse may be above the project's ceilings or out of balance.
 */
#include <stdlib.h>

#include "../ports/host/st_memory.h"
#include "st_inside.h"

#define ELECTRODES 6u

static st_board board;
static st_memory memory;
static uint32_t draws, number, sequence_number;
static uint64_t now_us, session, free_us;
static uint8_t output;
static bool opened;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static uint32_t draw(void *self)
{
    (void)self;
    draws++;
    return draws;
}

static void send(void *self, const uint8_t *data, size_t size)
{
    (void)self;
    /* What the board says is a packet that ends with the only zero; a long one comes by pieces. */
    if (size < 1u || (data[size - 1u] != 0u && size <= 256u)
        || memchr(data, 0, size - 1u) != NULL) {
        abort();
    }
}

static void pulse(void *self, const st_pulse *pulse)
{
    int32_t net_ua = 0;
    uint32_t all_ua = 0;
    (void)self;
    const bool recharges = pulse->slot == ST_NOTHING;
    for (uint32_t each = 0; each < ELECTRODES; each++) {
        const int32_t ua = pulse->current_ua[each];
        const uint32_t magnitude = (uint32_t)(ua < 0 ? -ua : ua);
        net_ua += ua;
        all_ua += magnitude;
        if (output == ST_WEIGHTED
            && (magnitude > (recharges ? 500u : 5000u)
                || magnitude * pulse->width_us > (recharges ? 2000000u : 500000u))) {
            abort();
        }
    }
    if (output == ST_WEIGHTED && (net_ua != 0 || all_ua > 20000u)) {
        abort();
    }
    if (output != ST_WEIGHTED && pulse->source_ua > 10000u) {
        abort();
    }
    if (pulse->width_us == 0u || pulse->width_us > (recharges ? 20000u : 200u)
        || board.refusing != 0u || opened || pulse->start_us > board.heard_us + ST_SILENCE_US
        || pulse->start_us < free_us || pulse->start_us > now_us
        || (board.config.real_time && pulse->start_us != now_us)) {
        abort();
    }
    free_us = pulse->start_us + pulse->width_us + (recharges ? 0u : ST_MIN_DISCHARGE_US);
}

static void shorted(void *self, const char *reason)
{
    (void)self;
    (void)reason;
    free_us = 0;
}

static int16_t force_mn(void *self)
{
    (void)self;
    return 0;
}

/* Asked once for each slot, when its pulse is over. */
static uint16_t volts(void *self)
{
    (void)self;
    if (board.running == NULL || board.running->measured >= board.config.most_slots) {
        abort();
    }
    return (uint16_t)now_us;
}

static bool emergency_open(void *self)
{
    (void)self;
    return opened;
}

static uint32_t left_pc(void *self)
{
    (void)self;
    return draws;
}

/* Send a packet that is right but for its payload. */
static void say(uint8_t kind, uint32_t about, const uint8_t *payload, size_t size)
{
    static uint8_t body[70000];
    static uint8_t coded[70600];
    if (size > 65000u) {
        return;
    }
    number++;
    const uint32_t words[5] = { number, (uint32_t)session, (uint32_t)(session >> 32),
                                board.session.said, about };
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
    const uint32_t crc = st_crc32(0, body, end);
    for (unsigned byte = 0; byte < 4u; byte++) {
        body[end++] = (uint8_t)(crc >> (8u * byte));
    }
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
    st_feed(&board, coded, out, now_us);
}

static void begin(void)
{
    st_hang_up(&board, now_us);
    session = 1u + draws;
    number = 0;
    say(ST_HELLO, 0, NULL, 0);
    session |= (uint64_t)board.session.challenge << 32;
    say(ST_BEGIN, 0, NULL, 0);
    sequence_number = 0;
}

static void give_limits(void)
{
    static const uint8_t head[28] = { 0x88, 0x13, 0, 0, 0x10, 0x27, 0, 0, 200, 0, 0x88, 0x13, 4, 0,
                                      0, 0, 0xF4, 1, 0x10, 0x0E, 0x40, 0x77, 0x1B, 0, 80 };
    uint8_t payload[28u + 8u * ELECTRODES];
    memcpy(payload, head, sizeof head);
    memset(payload + 28, 0x20, 4u * ELECTRODES);
    memset(payload + 28u + 4u * ELECTRODES, 0x07, 4u * ELECTRODES);
    say(ST_LIMITS, 0, payload, sizeof payload);
}

static void give_kernels(const uint8_t *data, size_t size)
{
    static uint8_t payload[ST_LOAD_HEAD + 65000u];
    if (size > 65000u) {
        return;
    }
    st_sha256 hash;
    st_sha256_begin(&hash);
    st_sha256_add(&hash, data, size);
    st_sha256_end(&hash, payload);
    (void)st_put_u32(st_put_u32(payload + ST_IDENTITY_BYTES, (uint32_t)size), 0);
    memcpy(payload + ST_LOAD_HEAD, data, size);
    say(ST_LOAD, 0, payload, ST_LOAD_HEAD + size);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    const st_port port = { NULL, draw, send, pulse, shorted, force_mn, volts, left_pc, emergency_open };
    st_config config;
    if (size < 1u) {
        return 0;
    }
    output = data[0] % 3u;
    draws = number = sequence_number = 0;
    now_us = session = free_us = 0;
    opened = false;
    st_configure(&config, &memory, ELECTRODES, output, (data[0] & 0x80u) != 0u ? 500 : 0);
    config.real_time = (data[0] & 0x40u) != 0u;
    config.packet_bytes = 4096;
    config.kernel_bytes = 2048;
    config.most_kernels = 16;
    config.features |= (data[0] & 0x20u) != 0u ? ST_VOLTAGE : 0;
    config.features |= ST_SWITCH;
    st_init(&board, &config, &port);
    for (size_t at = 1; at + 3u <= size;) {
        const uint8_t act = data[at];
        /* The upper half of the byte says whether the emergency switch is open. */
        opened = (act & 0xF0u) == 0xF0u;
        const uint16_t length = st_u16(data + at + 1);
        at += 3u;
        const size_t left = size - at;
        const size_t count = length < left ? length : left;
        const uint8_t *body = data + at;
        switch (act % 8u) {
        case 0:
            now_us += length;
            st_advance(&board, now_us);
            continue;
        case 1:
            st_feed(&board, body, count, now_us);
            break;
        case 2:
            /* Of any type: the first byte says which. */
            say(count > 0u ? body[0] : (uint8_t)ST_STATUS, sequence_number, body, count);
            break;
        case 3:
            begin();
            continue;
        case 4:
            give_limits();
            continue;
        case 5:
            give_kernels(body, count);
            break;
        default:
            sequence_number++;
            say(ST_SEQUENCE, sequence_number, body, count);
            break;
        }
        at += count;
    }
    now_us += 300000;
    st_advance(&board, now_us);
    return 0;
}
