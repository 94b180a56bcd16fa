/* The core as a library for tests: one board, whose bytes and pulses are collected. */
#include <stdlib.h>

#include "st_inside.h"
#include "st_memory.h"

#define ROOM (1u << 22)

typedef struct {
    st_board board;
    st_memory memory;
    uint32_t draws;
    uint32_t out_size, pulses;
    uint8_t out[ROOM];
    int16_t currents[ROOM];
    uint32_t numbers[ROOM / 4], slots[ROOM / 4], sites[ROOM / 4], widths[ROOM / 4];
    uint64_t starts[ROOM / 4];
    const char *reason;
    st_driven driven;
    uint64_t now_us;
    bool open; /* the emergency switch */
    void (*skin)(const uint32_t *times, uint64_t start_us, const int16_t *current_ua,
                 uint32_t *found);
    uint32_t found[2]; /* the source's voltage in 10 mV, and the largest charge left in pC */
} st_rig;

/* What the tests call. */
st_rig *st_rig_new(uint16_t electrodes, uint8_t output, uint8_t features, uint16_t compliance_v,
                   uint16_t ramp_ms, bool played, const char *name);
void st_rig_free(st_rig *rig);
void st_rig_wear(st_rig *rig, void (*skin)(const uint32_t *times, uint64_t start_us,
                                           const int16_t *current_ua, uint32_t *found));
void st_rig_driven(const st_rig *rig, int64_t *driven_pc);
void st_rig_feed(st_rig *rig, const uint8_t *data, size_t size, uint64_t now_us);
void st_rig_advance(st_rig *rig, uint64_t now_us);
void st_rig_hang_up(st_rig *rig, uint64_t now_us);
void st_rig_zero(st_rig *rig);
void st_rig_switch(st_rig *rig, bool open);
void st_rig_hash(const uint8_t *data, size_t size, size_t piece, uint8_t *digest);
uint32_t st_rig_take(st_rig *rig, uint8_t *out, uint32_t *numbers, uint32_t *slots,
                     uint32_t *sites, uint32_t *widths, uint64_t *starts, int16_t *currents,
                     uint32_t *pulses);
void st_rig_books(const st_rig *rig, uint64_t *books);
const char *st_rig_reason(const st_rig *rig);

static uint64_t now_us(void *self)
{
    const st_rig *rig = self;
    return rig->now_us;
}

static uint32_t draw(void *self)
{
    st_rig *rig = self;
    rig->draws++;
    return rig->draws;
}

static void send(void *self, const uint8_t *data, size_t size)
{
    st_rig *rig = self;
    if (rig->out_size + size <= ROOM) {
        memcpy(rig->out + rig->out_size, data, size);
        rig->out_size += (uint32_t)size;
    }
}

static uint64_t pulse(void *self, const st_pulse *pulse)
{
    st_rig *rig = self;
    const uint32_t electrodes = rig->board.config.electrodes;
    const uint32_t at = rig->pulses;
    rig->reason = "driving";
    st_driven_pulse(&rig->driven, &rig->board, pulse);
    if (rig->skin != NULL) {
        const uint32_t times[3] = { pulse->width_us, pulse->rest_us, pulse->source_ua };
        rig->skin(times, pulse->start_us, pulse->current_ua, rig->found);
    }
    const uint64_t begun_us = rig->board.config.played ? pulse->start_us : rig->now_us;
    if (at >= ROOM / 4 || (at + 1u) * electrodes > ROOM) {
        return begun_us;
    }
    rig->numbers[at] = pulse->number;
    rig->slots[at] = pulse->slot;
    rig->sites[at] = pulse->site;
    rig->widths[at] = pulse->width_us;
    rig->starts[at] = begun_us;
    memcpy(rig->currents + at * electrodes, pulse->current_ua, 2u * electrodes);
    rig->pulses++;
    return begun_us;
}

static uint16_t volts(void *self)
{
    const st_rig *rig = self;
    return (uint16_t)rig->found[0];
}

static uint32_t left_pc(void *self)
{
    const st_rig *rig = self;
    return rig->found[1];
}

static void shorted(void *self, const char *reason)
{
    st_rig *rig = self;
    rig->reason = reason;
    st_driven_until(&rig->driven, rig->board.config.electrodes,
                    strcmp(reason, "end") == 0 ? UINT64_MAX : rig->board.executed_us);
}

static int16_t force_mn(void *self)
{
    (void)self;
    return 1000;
}

static bool emergency_open(void *self)
{
    const st_rig *rig = self;
    return rig->open;
}

st_rig *st_rig_new(uint16_t electrodes, uint8_t output, uint8_t features, uint16_t compliance_v,
                   uint16_t ramp_ms, bool played, const char *name)
{
    st_rig *rig = calloc(1, sizeof *rig);
    st_config config;
    const st_port port = { rig, now_us, draw, send, pulse, shorted, force_mn, volts, left_pc,
                           emergency_open };
    if (rig != NULL) {
        st_configure(&config, &rig->memory, electrodes, output, ramp_ms);
        config.features = features;
        config.compliance_v = compliance_v;
        config.name = name;
        if (st_init(&rig->board, &config, &port) != NULL) {
            free(rig);
            return NULL;
        }
        /* In real time the clock still stands within a call. */
        rig->board.config.played = played;
    }
    return rig;
}

void st_rig_free(st_rig *rig)
{
    free(rig);
}

/* Set the function that computes each pulse's effect on a skin, before the pulse is reported. */
void st_rig_wear(st_rig *rig, void (*skin)(const uint32_t *times, uint64_t start_us,
                                           const int16_t *current_ua, uint32_t *found))
{
    rig->skin = skin;
}

void st_rig_driven(const st_rig *rig, int64_t *driven_pc)
{
    for (uint32_t each = 0; each < rig->board.config.electrodes; each++) {
        driven_pc[each] = rig->driven.pc[each];
    }
}

void st_rig_feed(st_rig *rig, const uint8_t *data, size_t size, uint64_t now_us)
{
    rig->now_us = now_us;
    st_feed(&rig->board, data, size);
}

void st_rig_advance(st_rig *rig, uint64_t now_us)
{
    rig->now_us = now_us;
    st_advance(&rig->board);
}

void st_rig_hang_up(st_rig *rig, uint64_t now_us)
{
    rig->now_us = now_us;
    st_hang_up(&rig->board);
}

void st_rig_zero(st_rig *rig)
{
    st_zero(&rig->board, "fault");
}

/* Open or close the emergency switch. */
void st_rig_switch(st_rig *rig, bool open)
{
    rig->open = open;
}

/* Hash data, given by pieces. */
void st_rig_hash(const uint8_t *data, size_t size, size_t piece, uint8_t *digest)
{
    st_sha256 hash;
    st_sha256_begin(&hash);
    for (size_t at = 0; at < size; at += piece) {
        st_sha256_add(&hash, data + at, size - at < piece ? size - at : piece);
    }
    st_sha256_end(&hash, digest);
}

uint32_t st_rig_take(st_rig *rig, uint8_t *out, uint32_t *numbers, uint32_t *slots,
                     uint32_t *sites, uint32_t *widths, uint64_t *starts, int16_t *currents,
                     uint32_t *pulses)
{
    const uint32_t size = rig->out_size;
    const uint32_t count = rig->pulses;
    memcpy(out, rig->out, size);
    memcpy(numbers, rig->numbers, 4u * count);
    memcpy(slots, rig->slots, 4u * count);
    memcpy(sites, rig->sites, 4u * count);
    memcpy(widths, rig->widths, 4u * count);
    memcpy(starts, rig->starts, 8u * count);
    memcpy(currents, rig->currents, 2u * count * rig->board.config.electrodes);
    *pulses = count;
    rig->out_size = rig->pulses = 0;
    return size;
}

void st_rig_books(const st_rig *rig, uint64_t *books)
{
    const st_books *own = &rig->board.books;
    books[0] = own->sequences;
    books[1] = own->slots;
    books[2] = own->pulses;
    books[3] = own->violations;
    books[4] = own->framing_errors;
    books[5] = own->old_packets;
    books[6] = own->foreign_packets;
    books[7] = own->max_current_ua;
    books[8] = own->max_charge_pc;
}

const char *st_rig_reason(const st_rig *rig)
{
    return rig->reason;
}
