/* Shim for ESP32 boards with high-voltage shift registers and one current DAC: HV507, HV513.
 *
 * UNTESTED ON HARDWARE: compiled against stand-in headers alone. Two bits for each electrode go
 * through the registers, the cathode's switch and the anode's; both on short it to the others.
 */
#include <Arduino.h>
#include <string.h>

#include "st_board.h"

#define ELECTRODES 64u
#define PIN_LATCH 5
#define UA_PER_COUNT_Q8 1250u /* 4.88 uA for a count of the DAC, in 1/256: of your board's resistor */
#define PACKET_BYTES 8192u

void setup(void);
void loop(void);

static st_board board;
static uint8_t buffer[ST_BUFFERS][PACKET_BYTES];
static int32_t sums[ELECTRODES];
static int16_t states[ELECTRODES];
static st_electrode electrodes[ELECTRODES];

static void latch(const uint8_t *bits)
{
    digitalWrite(PIN_LATCH, LOW);
    spi_write_bytes(bits, ELECTRODES / 4u);
    digitalWrite(PIN_LATCH, HIGH);
}

static void short_all(void)
{
    uint8_t bits[ELECTRODES / 4u];
    dac_write(0);
    memset(bits, 0xFF, sizeof bits);
    latch(bits);
}

static void shorted(void *self, const char *reason)
{
    (void)self;
    (void)reason;
    short_all();
}

static void pulse(void *self, const st_pulse *pulse)
{
    uint8_t bits[ELECTRODES / 4u];
    (void)self;
    memset(bits, 0, sizeof bits);
    for (uint32_t each = 0; each < ELECTRODES; each++) {
        const int16_t state = pulse->current_ua[each];
        const uint32_t code = state > 0 ? 1u : state < 0 ? 2u : 0u;
        bits[each / 4u] |= (uint8_t)(code << (2u * (each % 4u)));
    }
    latch(bits);
    /* Nothing may come between: a timer that fires before the current is there would not end it. */
    noInterrupts();
    one_shot_us(pulse->width_us, short_all);
    dac_write((uint16_t)((pulse->source_ua * 256u) / UA_PER_COUNT_Q8));
    interrupts();
}

static uint32_t draw(void *self)
{
    uint32_t bits;
    (void)self;
    do {
        bits = esp_random();
    } while (bits == 0u);
    return bits;
}

static void send(void *self, const uint8_t *data, size_t size)
{
    (void)self;
    serial_write(data, size);
}

static int16_t force_mn(void *self)
{
    (void)self;
    return 0;
}

void setup(void)
{
    static const st_port port = { NULL, draw, send, pulse, shorted, force_mn, NULL, NULL, NULL };
    st_config config;
    pinMode(PIN_LATCH, OUTPUT);
    memset(&config, 0, sizeof config);
    config.electrodes = ELECTRODES;
    config.output = ST_THREE_STATE;
    config.most_slots = 1024;
    config.ramp_ms = 500;
    config.real_time = true;
    config.packet_bytes = PACKET_BYTES;
    for (unsigned index = 0; index < ST_BUFFERS; index++) {
        config.buffer[index] = buffer[index];
    }
    config.sums = sums;
    config.current_ua = states;
    config.each = electrodes;
    config.name = "SmartTouch firmware 1, ESP32, untested";
    st_init(&board, &config, &port);
}

void loop(void)
{
    uint8_t data[256];
    const size_t size = serial_read(data, sizeof data);
    const uint64_t now_us = (uint64_t)esp_timer_get_time();
    if (size > 0u) {
        st_feed(&board, data, size, now_us);
    } else {
        st_advance(&board, now_us);
    }
}
