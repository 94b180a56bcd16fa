/* The board on a Cortex-M3, as QEMU plays it (mps2-an385): UART 0 is the line to the host, and
 * every pulse is written to UART 1 as
 *
 *     u32 number, u32 start in us, u16 slot, u16 site, u16 width in us, u16 source in uA, i16 [E]
 *
 * and every time all electrodes are shorted, but for a pulse's end, as a record of the same length
 * without a width: the reason's first four letters, u32 time in us, u32 us since the host's last
 * sign of life, u16 0, u16 refused sequences. Words after its name set its kind:
 * electrodes (64 at most), output (0, 1, 2), least time from zero to full in ms; with ST_WATCHDOG also
 * the pulses after which it stands still, with interrupts off, for its watchdog to end.
 *
 * With ST_MEASURE it measures itself instead: see st_measure.h.
 */
#include <string.h>

#include "st_board.h"
#include "st_inside.h"

#ifndef ST_ELECTRODES
#define ST_ELECTRODES 64u
#endif
#define PACKET_BYTES 65536u
#define KERNEL_BYTES 524288u
#define MOST_KERNELS 1024u
#define RING 4096u
#define CLOCK_PER_US 25u

typedef struct {
    volatile uint32_t data, state, control, interrupt, divider;
} st_uart;

#define UART0 ((st_uart *)0x40004000u)
#define UART1 ((st_uart *)0x40005000u)
#define TICK_CONTROL (*(volatile uint32_t *)0xE000E010u)
#define TICK_RELOAD (*(volatile uint32_t *)0xE000E014u)
#define TICK_VALUE (*(volatile uint32_t *)0xE000E018u)
#define WATCHDOG(offset) (*(volatile uint32_t *)(0x40008000u + (offset)))
#define WATCHDOG_US 25000u /* two of these are a reset */
#define INTERRUPTS_ENABLED (*(volatile uint32_t *)0xE000E100u)

extern uint32_t st_data[], st_data_end[], st_data_from[], st_bss[], st_bss_end[], st_stack[];
void st_reset(void);

static st_board board;
static uint8_t buffer[ST_BUFFERS][PACKET_BYTES];
static uint8_t kernels[KERNEL_BYTES];
static uint32_t kernel_at[MOST_KERNELS];
static int32_t sums[ST_ELECTRODES];
static int16_t current_ua[ST_ELECTRODES], pulse_ua[ST_ELECTRODES];
static st_electrode electrodes[ST_ELECTRODES];
static uint8_t ring[RING];
static volatile uint32_t ring_in, ring_out, milliseconds;
static uint32_t random_state, stands_after;

static void on_tick(void)
{
    milliseconds++;
}

static void on_byte(void)
{
    while ((UART0->state & 2u) != 0u && ring_in - ring_out < RING) {
        ring[ring_in % RING] = (uint8_t)UART0->data;
        ring_in++;
    }
    UART0->interrupt = 2u;
}

static void on_fault(void)
{
    /* All outputs of this board are ended by timers: nothing goes on. */
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static const uintptr_t vectors[] = {
    (uintptr_t)st_stack, (uintptr_t)st_reset, (uintptr_t)on_fault, (uintptr_t)on_fault,
    (uintptr_t)on_fault, (uintptr_t)on_fault, (uintptr_t)on_fault, 0, 0, 0, 0,
    (uintptr_t)on_fault, (uintptr_t)on_fault, 0, (uintptr_t)on_fault, (uintptr_t)on_tick,
    (uintptr_t)on_byte,
};

static uint64_t now_us(void *self)
{
    static uint64_t last_us;
    (void)self;
    uint32_t before;
    uint32_t value;
    do {
        before = milliseconds;
        value = TICK_VALUE;
    } while (before != milliseconds);
    /* The counter may have begun anew with its interrupt still to come: then it stands still. */
    last_us = st_longer_us(
        last_us, 1000u * before + (1000u * CLOCK_PER_US - 1u - value) / CLOCK_PER_US);
    return last_us;
}

static uint32_t semihosting(uint32_t what, const void *with)
{
    register uint32_t r0 __asm__("r0") = what;
    register const void *r1 __asm__("r1") = with;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static uint32_t draw(void *self)
{
    (void)self;
    do {
        random_state ^= (uint32_t)now_us(NULL);
        random_state ^= random_state << 13;
        random_state ^= random_state >> 17;
        random_state ^= random_state << 5;
    } while (random_state == 0u);
    return random_state;
}

static void put(st_uart *uart, const void *data, size_t size)
{
    const uint8_t *bytes = data;
    for (size_t at = 0; at < size; at++) {
        while ((uart->state & 1u) != 0u) {
        }
        uart->data = bytes[at];
    }
}

static void send(void *self, const uint8_t *data, size_t size)
{
    (void)self;
    put(UART0, data, size);
}

static uint64_t pulse(void *self, const st_pulse *pulse)
{
    /* Interrupts off, so that nothing comes between the question and the current. */
    __asm__ volatile("cpsid i" ::: "memory");
    const bool may = st_may_pulse(&board);
    const uint64_t begun_us = now_us(NULL);
    __asm__ volatile("cpsie i" ::: "memory");
    if (!may) {
        return ST_NOT_BEGUN_US;
    }
    const uint32_t times[2] = { pulse->number, (uint32_t)begun_us };
    const uint16_t others[4] = { pulse->slot, pulse->site, pulse->width_us, pulse->source_ua };
    (void)self;
    put(UART1, times, sizeof times);
    put(UART1, others, sizeof others);
    put(UART1, pulse->current_ua, 2u * (size_t)board.config.electrodes);
    if (stands_after != 0u && board.books.slots + 1u == stands_after) {
        __asm__ volatile("cpsid i" ::: "memory");
        for (;;) {
        }
    }
    return begun_us;
}

static void shorted(void *self, const char *reason)
{
    static const int16_t nothing[ST_ELECTRODES];
    const uint32_t now = (uint32_t)now_us(NULL);
    const uint32_t times[2] = { now, now - (uint32_t)board.heard_us };
    const uint16_t others[2] = { 0, (uint16_t)board.books.violations };
    (void)self;
    put(UART1, reason, 4);
    put(UART1, times, sizeof times);
    put(UART1, others, sizeof others);
    put(UART1, nothing, 2u * (size_t)board.config.electrodes);
}

static int16_t force_mn(void *self)
{
    (void)self;
    return 1000;
}

/* Read the numbers that follow the name in a command line. */
static void read_words(const char *text, uint16_t *numbers, size_t most)
{
    size_t count = 0;
    while (*text != '\0' && count < most) {
        const bool begins = *text == ' ' && text[1] >= '0' && text[1] <= '9';
        text++;
        if (begins) {
            numbers[count] = 0;
            for (; *text >= '0' && *text <= '9'; text++) {
                numbers[count] = (uint16_t)(10u * numbers[count] + (uint32_t)(*text - '0'));
            }
            count++;
        }
    }
}

static void start(void)
{
    static const st_port port = { NULL, now_us, draw, send, pulse, shorted, force_mn, NULL, NULL,
                                  NULL };
    uint16_t numbers[4] = { ST_ELECTRODES, 0, 500, 0 };
    st_config config;
#ifndef ST_MEASURE
    static char words[80];
    struct {
        char *text;
        size_t size;
    } line = { words, sizeof words };
    if (semihosting(0x15, &line) == 0u) {
        read_words(words, numbers, 4);
    }
#else
    (void)read_words;
#endif
    stands_after = numbers[3];
    memset(&config, 0, sizeof config);
    config.electrodes = numbers[0] <= ST_ELECTRODES ? numbers[0] : ST_ELECTRODES;
    config.output = (uint8_t)(ST_WEIGHTED + numbers[1]);
    config.features = ST_KERNELS | ST_FORCE;
    config.features |= config.output == ST_WEIGHTED ? ST_RECHARGE : 0;
    config.most_slots = 4096;
    config.ramp_ms = numbers[2];
    config.no_ramp = numbers[2] == 0u;
    config.most_kernels = MOST_KERNELS;
    config.packet_bytes = PACKET_BYTES;
    config.kernel_bytes = KERNEL_BYTES;
    for (unsigned index = 0; index < ST_BUFFERS; index++) {
        config.buffer[index] = buffer[index];
    }
    config.kernels = kernels;
    config.kernel_at = kernel_at;
    config.sums = sums;
    config.current_ua = current_ua;
    config.pulse_ua = pulse_ua;
    config.each = electrodes;
    config.name = "SmartTouch firmware 1, Cortex-M3";
    const char *wrong = st_init(&board, &config, &port);
    if (wrong != NULL) {
        put(UART0, wrong, strlen(wrong));
        put(UART0, "\n", 1);
    }
}

#ifdef ST_MEASURE
#include "st_measure.h"
#endif

void st_reset(void)
{
    memcpy(st_data, st_data_from, (size_t)((uint8_t *)st_data_end - (uint8_t *)st_data));
    memset(st_bss, 0, (size_t)((uint8_t *)st_bss_end - (uint8_t *)st_bss));
    UART0->divider = UART1->divider = 16;
    UART0->control = 1u | 2u | 8u;
    UART1->control = 1u;
    TICK_RELOAD = 1000u * CLOCK_PER_US - 1u;
    TICK_VALUE = 0;
    TICK_CONTROL = 7;
    INTERRUPTS_ENABLED = 1;
#ifndef ST_MEASURE
    random_state = semihosting(0x11, NULL) * 2654435761u ^ semihosting(0x10, NULL);
#else
    random_state = 1;
#endif
    start();
#ifdef ST_WATCHDOG
    /* Not in all tests: on a busy machine QEMU stands still for longer. */
    WATCHDOG(0x00) = WATCHDOG_US * CLOCK_PER_US;
    WATCHDOG(0x08) = 3;
#endif
#ifdef ST_MEASURE
    measure();
    (void)semihosting(0x18, (const void *)0x20026);
#endif
    for (;;) {
        uint8_t data[256];
        size_t size = 0;
        WATCHDOG(0x0C) = 1;
        while (ring_out != ring_in && size < sizeof data) {
            data[size++] = ring[ring_out % RING];
            ring_out++;
        }
        if ((UART0->state & 2u) != 0u) {
            /* The ring was full when it came. */
            __asm__ volatile("cpsid i" ::: "memory");
            on_byte();
            __asm__ volatile("cpsie i" ::: "memory");
        }
        if (size > 0u) {
            st_feed(&board, data, size);
        } else {
            st_advance(&board);
            if (st_next_us(&board) > now_us(NULL) + 1000u) {
                __asm__ volatile("wfi");
            }
        }
    }
}
