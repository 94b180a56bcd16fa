/* All that a host may send, for libFuzzer: raw bytes, and packets whose head and CRC are right.
 *
 * An input is a list of acts: a byte that says which, two that say how long, and what it takes.
 * Whatever comes, no pulse may be above the project's ceilings or out of balance.
 */
#include <stdlib.h>

#include "../ports/host/st_memory.h"
#include "../ports/host/st_host_packets.h"

#define ELECTRODES 6u

static st_board board;
static st_memory memory;
static st_talk talk;
static uint32_t draws, sequence_number;
static uint64_t now_us, free_us;
static uint8_t output;
static bool opened;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static uint64_t clock_us(void *self)
{
    (void)self;
    return now_us;
}

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

static uint64_t pulse(void *self, const st_pulse *pulse)
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
    const uint64_t begun_us = board.config.played ? pulse->start_us : now_us;
    if (pulse->width_us == 0u || pulse->width_us > (recharges ? 20000u : 200u)
        || board.refusing != 0u || opened || begun_us > board.heard_us + ST_SILENCE_US
        || begun_us < free_us || pulse->start_us > now_us) {
        abort();
    }
    free_us = begun_us + pulse->width_us + (recharges ? 0u : ST_MIN_DISCHARGE_US);
    return begun_us;
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
    st_talk_say(&talk, &board, ST_LOAD, 0, payload, ST_LOAD_HEAD + size);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    const st_port port = { NULL, clock_us, draw, send, pulse, shorted, force_mn, volts, left_pc,
                           emergency_open };
    st_config config;
    if (size < 1u) {
        return 0;
    }
    output = (uint8_t)(ST_WEIGHTED + data[0] % 3u);
    draws = sequence_number = 0;
    now_us = free_us = 0;
    memset(&talk, 0, sizeof talk);
    opened = false;
    st_configure(&config, &memory, ELECTRODES, output, (data[0] & 0x80u) != 0u ? 500 : 0);
    config.packet_bytes = 4096;
    config.kernel_bytes = 2048;
    config.most_kernels = 16;
    config.features |= (data[0] & 0x20u) != 0u ? ST_VOLTAGE : 0;
    config.features |= ST_SWITCH;
    /* In real time, but for the clock, which stands still within a call. */
    if (st_init(&board, &config, &port) != NULL) {
        abort();
    }
    board.config.played = (data[0] & 0x40u) == 0u;
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
            st_advance(&board);
            continue;
        case 1:
            st_feed(&board, body, count);
            break;
        case 2:
            /* Of any type: the first byte says which. */
            st_talk_say(&talk, &board, count > 0u ? body[0] : (uint8_t)ST_STATUS,
                        sequence_number, body, count);
            break;
        case 3:
            st_hang_up(&board);
            st_talk_begin(&talk, &board, 1u + draws);
            sequence_number = 0;
            continue;
        case 4:
            st_talk_limits(&talk, &board);
            continue;
        case 5:
            give_kernels(body, count);
            break;
        default:
            sequence_number++;
            st_talk_say(&talk, &board, ST_SEQUENCE, sequence_number, body, count);
            break;
        }
        at += count;
    }
    now_us += 300000;
    st_advance(&board);
    return 0;
}
