/* A kit's board on an STM32F405 with a crystal of 8 MHz, without vendor code. Section numbers are
 * those of the reference manual RM0090.
 *
 * PA9, PA10  USART1: the line to the host, 921,600 baud
 * PA5, PA7   SPI1: clock and data of the shift registers, which take over at the falling edge of
 * PA4        LE
 * PB6        BL, by TIM4 channel 1 in one-pulse mode: it falls by itself after the pulse's width,
 *            whatever the processor does; a resistor of 10 kOhm holds it low until then
 * PB7        POL, high
 * PB13, PB15 SPI2: clock and data of the converter, an AD5452 or MCP4921
 * PB12       its chip select
 * PC13       the emergency switch, which connects it to ground in normal use
 *
 * The independent watchdog resets after 50 ms without the loop; the brown-out level must be set to 3
 * (2.7 V) in the option bytes: without it, nothing begins. NOT SEEN on hardware yet.
 *
 * ST_KIT names the kit. With ST_QEMU the clock is as QEMU's netduinoplus2 has it, and the switch
 * closed: it plays neither.
 */
#include <string.h>

#include "st_shift_registers.h"

#ifndef ST_KIT
#define ST_KIT st_kajimoto61
#endif
#define MOST_ELECTRODES 64u
#define PACKET_BYTES 8192u
#define RING 4096u
#define MHZ 168u

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define RCC(offset) REGISTER(0x40023800u + (offset))   /* 7.3 */
#define FLASH(offset) REGISTER(0x40023C00u + (offset)) /* 3.9 */
#define GPIOA(offset) REGISTER(0x40020000u + (offset)) /* 8.4 */
#define GPIOB(offset) REGISTER(0x40020400u + (offset))
#define GPIOC(offset) REGISTER(0x40020800u + (offset))
#define SYSCFG_EXTICR4 REGISTER(0x40013814u)           /* 9.2.6 */
#define EXTI(offset) REGISTER(0x40013C00u + (offset))  /* 12.3 */
#define TIM4(offset) REGISTER(0x40000800u + (offset))  /* 18.4 */
#define IWDG(offset) REGISTER(0x40003000u + (offset))  /* 21.4 */
#define RNG(offset) REGISTER(0x50060800u + (offset))   /* 24.4 */
#define SPI1(offset) REGISTER(0x40013000u + (offset))  /* 28.5 */
#define SPI2(offset) REGISTER(0x40003800u + (offset))
#define USART1(offset) REGISTER(0x40011000u + (offset)) /* 30.6 */
#define TICK(offset) REGISTER(0xE000E010u + (offset))
#define INTERRUPTS_ENABLED(word) REGISTER(0xE000E100u + 4u * (word))

enum { MODER = 0x00, PUPDR = 0x0C, IDR = 0x10, BSRR = 0x18, AFRL = 0x20, AFRH = 0x24 };
enum { SPI_CR1 = 0x00, SPI_SR = 0x08, SPI_DR = 0x0C };
enum { TIM_CR1 = 0x00, TIM_DIER = 0x0C, TIM_SR = 0x10, TIM_EGR = 0x14, TIM_CCMR1 = 0x18,
       TIM_CCER = 0x20, TIM_CNT = 0x24, TIM_PSC = 0x28, TIM_ARR = 0x2C, TIM_CCR1 = 0x34 };
#define LE 4u
#define POL 7u
#define SELECT 12u
#define SILENT_US REGISTER(0x40023000u) /* of the CRC unit, which nothing here uses */

extern uint32_t st_data[], st_data_end[], st_data_from[], st_bss[], st_bss_end[], st_stack[];
void st_reset(void);

static st_board board;
static uint8_t buffer[ST_BUFFERS][PACKET_BYTES];
static int16_t current_ua[MOST_ELECTRODES], pulse_ua[MOST_ELECTRODES];
static st_electrode electrodes[MOST_ELECTRODES];
static uint8_t ring[RING];
static volatile uint32_t ring_in, ring_out, milliseconds;

/* Write one word to an SPI, and wait until it is out: at 10.5 MHz 16 bits take 1.5 us. */
static void spi_write(volatile uint32_t *spi, uint32_t word)
{
    spi[SPI_DR / 4] = word;
    while ((spi[SPI_SR / 4] & 1u) == 0u) {
        /* until as much has come back: RXNE */
    }
    (void)spi[SPI_DR / 4];
}

/* Set the converter by its select line and SPI 2. */
static void convert(uint16_t counts)
{
    GPIOB(BSRR) = 1u << (SELECT + 16u);
    spi_write(&SPI2(0), st_kit_word(&ST_KIT, counts));
    GPIOB(BSRR) = 1u << SELECT;
}

/* Stop the pulse's timer: BL falls to its idle level. Then take the current away. With interrupts
 * off, as some end pulses, too. */
static void end_pulse(void)
{
    uint32_t off;
    __asm__ volatile("mrs %0, primask\n\tcpsid i" : "=r"(off)::"memory");
    TIM4(TIM_CR1) = 0;
    TIM4(TIM_CNT) = 0;
    TIM4(TIM_SR) = 0;
    convert(0);
    __asm__ volatile("msr primask, %0" ::"r"(off) : "memory");
}

static void on_tick(void)
{
    milliseconds++;
}

static void on_byte(void)
{
    while ((USART1(0x00) & 0x20u) != 0u) {
        const uint8_t byte = (uint8_t)USART1(0x04);
        if (ring_in - ring_out < RING) {
            ring[ring_in % RING] = byte;
            ring_in++;
        }
    }
}

static void on_switch(void)
{
    EXTI(0x14) = 1u << 13;
    st_zero(&board, "emergency");
}

/* Nothing goes on after a fault: BL falls, and the watchdog resets. */
static void on_fault(void)
{
    end_pulse();
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static const uintptr_t vectors[16 + 41] = {
    [0] = (uintptr_t)st_stack,      [1] = (uintptr_t)st_reset,       [2] = (uintptr_t)on_fault,
    [3] = (uintptr_t)on_fault,      [4] = (uintptr_t)on_fault,       [5] = (uintptr_t)on_fault,
    [6] = (uintptr_t)on_fault,      [11] = (uintptr_t)on_fault,      [12] = (uintptr_t)on_fault,
    [14] = (uintptr_t)on_fault,     [15] = (uintptr_t)on_tick,       [16 + 30] = (uintptr_t)end_pulse,
    [16 + 37] = (uintptr_t)on_byte, [16 + 40] = (uintptr_t)on_switch,
};

static uint64_t now_us(void *self)
{
    static uint64_t last_us;
    uint32_t before;
    uint32_t value;
    (void)self;
    do {
        before = milliseconds;
        value = TICK(0x08);
    } while (before != milliseconds);
    /* The counter may have begun anew with its interrupt still to come: then it stands still. */
    last_us = st_longer_us(last_us, 1000u * before + (1000u * MHZ - 1u - value) / MHZ);
    return last_us;
}

/* Return a number of the random number generator; 0, with which nothing begins, if it has none. */
static uint32_t draw(void *self)
{
    (void)self;
#ifdef ST_QEMU
    return 0x5EED0000u + (uint32_t)now_us(NULL) % 0xFFFFu + 1u;
#else
    for (uint32_t wait = 0; wait < 100000u; wait++) {
        if ((RNG(0x04) & 1u) != 0u) {
            return RNG(0x08);
        }
    }
    return 0;
#endif
}

static void send(void *self, const uint8_t *data, size_t size)
{
    (void)self;
    for (size_t at = 0; at < size; at++) {
        while ((USART1(0x00) & 0x80u) == 0u) {
        }
        USART1(0x04) = data[at];
    }
}

static uint64_t pulse(void *self, const st_pulse *given)
{
    const st_kit *kit = &ST_KIT;
    uint8_t bits[MOST_ELECTRODES / 8u];
    (void)self;
    /* Whatever has become of the timer's interrupt: BL is low, and the converter at zero. */
    end_pulse();
    st_kit_bits(kit, given, bits);
    for (uint32_t at = 0; at < kit->chain_bits / 8u; at++) {
        spi_write(&SPI1(0), bits[at]);
    }
    GPIOA(BSRR) = 1u << LE;
    GPIOA(BSRR) = 1u << (LE + 16u);
    const uint16_t counts = st_kit_counts(kit, given->source_ua);
    TIM4(TIM_ARR) = given->width_us;
    __asm__ volatile("cpsid i" ::: "memory");
    const bool may = st_may_pulse(&board);
    const uint64_t begun_us = now_us(NULL);
    if (may) {
        /* BL rises with the timer's first count, and the current comes within 2 us of it: what is
         * connected to nothing never charges. */
        TIM4(TIM_CNT) = 0;
        TIM4(TIM_CR1) = 0x09u; /* one pulse, go */
        convert(counts);
    }
    __asm__ volatile("cpsie i" ::: "memory");
    return may ? begun_us : ST_NOT_BEGUN_US;
}

static void shorted(void *self, const char *reason)
{
    (void)self;
    (void)reason;
    end_pulse();
#ifdef ST_QEMU
    /* For its trace: how long the host has been silent, or ago its last packet was. */
    SILENT_US = (uint32_t)(now_us(NULL) - board.heard_us);
#endif
}

static bool emergency_open(void *self)
{
    (void)self;
#ifdef ST_QEMU
    return false;
#else
    return (GPIOC(IDR) & (1u << 13)) != 0u;
#endif
}

/* Run at 168 MHz from the crystal: 6.3, 7.3. Return whether it does. */
static bool start_clock(void)
{
#ifndef ST_QEMU
    uint32_t wait = 1000000u;
    RCC(0x00) |= 1u << 16;
    while ((RCC(0x00) & (1u << 17)) == 0u && wait > 0u) {
        wait--;
    }
    FLASH(0x00) = 0x705u;                    /* five wait states, caches */
    RCC(0x04) = 8u | (336u << 6) | (1u << 22) | (7u << 24);
    RCC(0x08) = (5u << 10) | (4u << 13);     /* APB1 42 MHz, APB2 84 MHz */
    RCC(0x00) |= 1u << 24;
    while ((RCC(0x00) & (1u << 25)) == 0u && wait > 0u) {
        wait--;
    }
    RCC(0x08) |= 2u;
    while ((RCC(0x08) & 0xCu) != 8u && wait > 0u) {
        wait--;
    }
    return wait > 0u;
#else
    return true;
#endif
}

/* Set up pins so that BL is low before its timer has it, then timer, SPI, line and watchdog. */
static void start_hardware(void)
{
    RCC(0x30) |= 7u;                              /* GPIOA to C */
    RCC(0x34) |= 1u << 6;                         /* RNG */
    RCC(0x40) |= (1u << 2) | (1u << 14);          /* TIM4, SPI2 */
    RCC(0x44) |= (1u << 4) | (1u << 12) | (1u << 14); /* USART1, SPI1, SYSCFG */
    RNG(0x00) = 4;
    GPIOA(BSRR) = 1u << (LE + 16u);
    GPIOB(BSRR) = (1u << (6u + 16u)) | (1u << POL) | (1u << SELECT);
    TIM4(TIM_PSC) = MHZ / 2u - 1u;                /* 84 MHz: a count is a microsecond */
    TIM4(TIM_CCMR1) = 0x70u;                      /* PWM mode 2: high from CCR1 on */
    TIM4(TIM_CCR1) = 1;
    TIM4(TIM_ARR) = 1;
    TIM4(TIM_CCER) = 1;
    TIM4(TIM_EGR) = 1;
    TIM4(TIM_SR) = 0;
    TIM4(TIM_DIER) = 1;
    GPIOA(AFRL) = (5u << 20) | (5u << 28);        /* SPI1 */
    GPIOA(AFRH) = (7u << 4) | (7u << 8);          /* USART1 */
    GPIOB(AFRL) = 2u << 24;                       /* TIM4 */
    GPIOB(AFRH) = (5u << 20) | (5u << 28);        /* SPI2 */
    GPIOC(PUPDR) = 1u << 26;
    GPIOA(MODER) = 0xA8000000u | (1u << 8) | (2u << 10) | (2u << 14) | (2u << 18) | (2u << 20);
    GPIOB(MODER) = 0x280u | (2u << 12) | (1u << 14) | (1u << 24) | (2u << 26) | (2u << 30);
    SPI1(SPI_CR1) = 0x354u;                       /* master, 84 MHz / 8, eight bits, on */
    /* Master, 42 MHz / 4, sixteen bits, on; the edge that the converter reads at. */
    SPI2(SPI_CR1) = 0xB4Cu | (ST_KIT.converter == ST_AD5452 ? 1u : 0u);
    USART1(0x08) = 91;                            /* 84 MHz / 921,600 */
    USART1(0x0C) = 0x202Cu;
    SYSCFG_EXTICR4 = 0x20u;                       /* line 13 is PC13 */
    EXTI(0x08) = 1u << 13;
    EXTI(0x00) = 1u << 13;
    TICK(0x04) = 1000u * MHZ - 1u;
    TICK(0x08) = 0;
    TICK(0x00) = 7;
    INTERRUPTS_ENABLED(0) = 1u << 30;             /* TIM4 */
    INTERRUPTS_ENABLED(1) = (1u << 5) | (1u << 8); /* USART1, lines 10 to 15 */
    convert(0);
    IWDG(0x00) = 0x5555u;
    IWDG(0x04) = 0;                               /* 32 kHz / 4 */
    IWDG(0x08) = 400;                             /* 50 ms */
    IWDG(0x00) = 0xCCCCu;
}

static const char *start_board(void)
{
    static const st_port port = { NULL, now_us, draw, send, pulse, shorted, NULL, NULL, NULL,
                                  emergency_open };
    const st_kit *kit = &ST_KIT;
    static st_config config;
    if (st_kit_wrong(kit) != NULL) {
        return st_kit_wrong(kit);
    }
    if (kit->electrodes > MOST_ELECTRODES || kit->chain_bits > MOST_ELECTRODES) {
        return "this port has 64 electrodes at most";
    }
    if ((FLASH(0x14) & 0xCu) != 0u) {
        return "the brown-out level in the option bytes is not 3";
    }
    config.electrodes = kit->electrodes;
    config.output = ST_ONE_AGAINST_ALL;
    config.features = ST_SWITCH;
    config.most_slots = 1024;
    config.ramp_ms = 500;
    config.packet_bytes = PACKET_BYTES;
    for (unsigned index = 0; index < ST_BUFFERS; index++) {
        config.buffer[index] = buffer[index];
    }
    config.current_ua = current_ua;
    config.pulse_ua = pulse_ua;
    config.each = electrodes;
    config.name = kit->name;
    return st_init(&board, &config, &port);
}

void st_reset(void)
{
    memcpy(st_data, st_data_from, (size_t)((uint8_t *)st_data_end - (uint8_t *)st_data));
    memset(st_bss, 0, (size_t)((uint8_t *)st_bss_end - (uint8_t *)st_bss));
    const bool runs = start_clock();
    start_hardware();
    const char *wrong = runs ? start_board() : "the crystal does not run";
    if (wrong != NULL) {
        send(NULL, (const uint8_t *)wrong, strlen(wrong));
        send(NULL, (const uint8_t *)"\n", 1);
        for (;;) {
            /* The watchdog begins another life. */
        }
    }
    uint32_t kicked = 0;
    for (;;) {
        uint8_t data[256];
        size_t size = 0;
        if (kicked != milliseconds) {
            kicked = milliseconds;
            IWDG(0x00) = 0xAAAAu;
        }
        while (ring_out != ring_in && size < sizeof data) {
            data[size++] = ring[ring_out % RING];
            ring_out++;
        }
        if (size > 0u) {
            st_feed(&board, data, size);
        } else {
            st_advance(&board);
            if (st_next_us(&board) > now_us(NULL) + 1000u) {
                /* A tick wakes it in time. */
                __asm__ volatile("wfi");
            }
        }
    }
}
