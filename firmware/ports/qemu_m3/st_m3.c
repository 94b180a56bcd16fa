/* The board on a Cortex-M3, as QEMU plays it (mps2-an385): UART 0 is the line to the host, and
 * every pulse is written to UART 1 as
 *
 *     u32 number, u32 start in us, u16 slot, u16 site, u16 width in us, u16 source in uA, i16 [E]
 *
 * and every time all electrodes are shorted, but for a pulse's end, as a record of the same length
 * without a width: the reason's first four letters, u32 time in us, u32 us since the host's last
 * sign of life, u16 0, u16 refused sequences. It may be told what to be by words after its name:
 * electrodes (64 at most), output (0, 1, 2), least time from zero to full in ms.
 *
 * With ST_MEASURE it counts instructions instead, where QEMU runs with -icount shift=0.
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
#define INTERRUPTS_ENABLED (*(volatile uint32_t *)0xE000E100u)

extern uint32_t st_data[], st_data_end[], st_data_from[], st_bss[], st_bss_end[], st_stack[];
void st_reset(void);

static st_board board;
static uint8_t buffer[ST_BUFFERS][PACKET_BYTES];
static uint8_t kernels[KERNEL_BYTES];
static uint32_t kernel_at[MOST_KERNELS];
static int32_t sums[ST_ELECTRODES];
static int16_t current_ua[ST_ELECTRODES];
static st_electrode electrodes[ST_ELECTRODES];
static uint8_t ring[RING];
static volatile uint32_t ring_in, ring_out, milliseconds;
static uint32_t random_state;

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

static uint64_t now_us(void)
{
    static uint64_t last_us;
    uint32_t before;
    uint32_t value;
    do {
        before = milliseconds;
        value = TICK_VALUE;
    } while (before != milliseconds);
    const uint64_t found_us =
        1000u * (uint64_t)before + (1000u * CLOCK_PER_US - 1u - value) / CLOCK_PER_US;
    /* The counter may have begun anew with its interrupt still to come. */
    last_us = found_us > last_us ? found_us : last_us;
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
        random_state ^= (uint32_t)now_us();
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

static void pulse(void *self, const st_pulse *pulse)
{
    const uint32_t times[2] = { pulse->number, (uint32_t)pulse->start_us };
    const uint16_t others[4] = { pulse->slot, pulse->site, pulse->width_us, pulse->source_ua };
    (void)self;
    put(UART1, times, sizeof times);
    put(UART1, others, sizeof others);
    put(UART1, pulse->current_ua, 2u * (size_t)board.config.electrodes);
}

static void shorted(void *self, const char *reason)
{
    static const int16_t nothing[ST_ELECTRODES];
    const uint32_t now = (uint32_t)now_us();
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
    static const st_port port = { NULL, draw, send, pulse, shorted, force_mn, NULL, NULL, NULL };
    uint16_t numbers[3] = { ST_ELECTRODES, ST_WEIGHTED, 500 };
    st_config config;
#ifndef ST_MEASURE
    static char words[80];
    struct {
        char *text;
        size_t size;
    } line = { words, sizeof words };
    if (semihosting(0x15, &line) == 0u) {
        read_words(words, numbers, 3);
    }
#else
    (void)read_words;
#endif
    memset(&config, 0, sizeof config);
    config.electrodes = numbers[0] <= ST_ELECTRODES ? numbers[0] : ST_ELECTRODES;
    config.output = (uint8_t)numbers[1];
    config.features = ST_KERNELS | ST_FORCE;
    config.features |= config.output == ST_WEIGHTED ? ST_RECHARGE : 0;
    config.most_slots = 4096;
    config.ramp_ms = numbers[2] == 0u ? ST_NO_RAMP : numbers[2];
    config.most_kernels = MOST_KERNELS;
    config.real_time = true;
    config.packet_bytes = PACKET_BYTES;
    config.kernel_bytes = KERNEL_BYTES;
    for (unsigned index = 0; index < ST_BUFFERS; index++) {
        config.buffer[index] = buffer[index];
    }
    config.kernels = kernels;
    config.kernel_at = kernel_at;
    config.sums = sums;
    config.current_ua = current_ua;
    config.each = electrodes;
    config.name = "SmartTouch firmware 1, Cortex-M3";
    st_init(&board, &config, &port);
}

#ifdef ST_MEASURE

static void say_count(const char *what, uint32_t points, uint64_t instructions)
{
    char text[80];
    size_t at = strlen(what);
    const uint64_t numbers[2] = { points, instructions };
    memcpy(text, what, at);
    for (unsigned which = 0; which < 2u; which++) {
        uint32_t rest = (uint32_t)numbers[which];
        uint32_t unit = 1;
        while (rest / unit >= 10u) {
            unit *= 10u;
        }
        text[at++] = ' ';
        for (; unit > 0u; unit /= 10u) {
            text[at++] = (char)('0' + rest / unit % 10u);
        }
    }
    text[at++] = '\n';
    put(UART0, text, at);
}

/* Instructions of a slot of a number of kernels: to check it, and to compute it again when it is
 * delivered; and of what is checked once for a sequence. With -icount shift=0 one takes a
 * nanosecond. */
static void measure(void)
{
    static uint8_t payload[4096];
    static const uint8_t head[14] = { 0x10, 0x27, 0, 0, 1, 0, 0xFF, 0xFF, 0, 1, 100, 0, 50, 0 };
    static const uint32_t counts[4] = { 1, 2, 8, 16 };
    uint8_t *at = kernels + 4;
    kernel_at[0] = 4;
    at[2] = 1;
    at[6] = ST_ELECTRODES & 0xFFu;
    at[7] = ST_ELECTRODES >> 8;
    for (uint32_t each = 0; each < ST_ELECTRODES; each++) {
        at[8u + 2u * each] = (uint8_t)(each + 1u);
        at[9u + 2u * each] = (each & 1u) != 0u ? 0xFF : 0;
    }
    for (uint32_t each = 0; each < ST_ELECTRODES; each += 2) {
        /* Minus as much at the neighbor. */
        const int32_t less = -(int32_t)st_i16(at + 8u + 2u * each);
        at[10u + 2u * each] = (uint8_t)less;
        at[11u + 2u * each] = (uint8_t)((uint32_t)less >> 8);
    }
    board.keep.whole = true;
    board.keep.count = 1;
    board.limits = (st_limits){ 5000, 10000, 200, 5000, 100, 0, 0, 3600, 1800000, 80, 200, true };
    for (uint32_t each = 0; each < ST_ELECTRODES; each++) {
        electrodes[each].limit_ua = 5000;
        electrodes[each].limit_pc = 500000;
    }
    for (unsigned which = 0; which < 4u; which++) {
        const uint32_t count = counts[which];
        st_sequence sequence;
        st_refusal refusal;
        uint16_t source_ua = 0;
        memcpy(payload, head, sizeof head);
        payload[14] = ST_SUM;
        payload[16] = (uint8_t)count;
        memset(payload + 18, 0, 4u * count);
        for (uint32_t pair = 0; pair < count; pair++) {
            payload[20u + 4u * pair] = 100;
        }
        const uint32_t group = 4u + 4u * count;
        memcpy(payload + 14u + group, payload + 14, group);
        (void)st_read_sequence(&board, payload, 14u + group, &sequence, &refusal);
        st_first_slot(&sequence, &sequence.place);
        uint64_t begun_us = now_us();
        for (unsigned turn = 0; turn < 1000u; turn++) {
            (void)st_slot_currents(&board, &sequence, &sequence.place, &source_ua);
        }
        say_count("deliver", count, now_us() - begun_us);
        uint64_t took_us[2];
        bool obeyed = true;
        for (unsigned more = 0; more < 2u; more++) {
            (void)st_read_sequence(&board, payload, 14u + (1u + more) * group, &sequence, &refusal);
            begun_us = now_us();
            for (unsigned turn = 0; turn < 1000u; turn++) {
                obeyed = obeyed && st_obeys(&board, &sequence, 1000000u, &refusal);
            }
            took_us[more] = now_us() - begun_us;
        }
        say_count(obeyed ? "check" : "refused", count, took_us[1] - took_us[0]);
        say_count("sequence", count, 2u * took_us[0] - took_us[1]);
    }
}

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
#ifdef ST_MEASURE
    measure();
    (void)semihosting(0x18, (const void *)0x20026);
#endif
    for (;;) {
        uint8_t data[256];
        size_t size = 0;
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
        const uint64_t now = now_us();
        if (size > 0u) {
            st_feed(&board, data, size, now);
        } else {
            st_advance(&board, now);
            if (st_next_us(&board) > now + 1000u) {
                __asm__ volatile("wfi");
            }
        }
    }
}
