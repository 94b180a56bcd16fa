/* What no port may break: `st_checks times SLOTS SEED`, `st_checks interrupts MS`, `st_checks init`.
 *
 * times: a port whose every function takes 0 to 500 us by chance. No pulse may begin before width
 * and rest of the last are over; and now and then a function calls st_zero, after which nothing may
 * begin. interrupts: a thread in place of one calls st_zero. init: each field left out by itself.
 * The first line printed is what was found; the exit status is 1 if something is wrong.
 */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "../ports/host/st_host_packets.h"

#define ELECTRODES 4u
#define PACKET 4096u

static st_board board;
static st_talk talk;
static uint8_t buffer[ST_BUFFERS][PACKET], kernels[64], volts_kept[2u * 64u];
static uint32_t kernel_at[4];
static int32_t sums[ELECTRODES];
static int16_t current_ua[ELECTRODES], pulse_ua[ELECTRODES];
static st_electrode each[ELECTRODES];

static uint64_t played_us, free_us, seed;
static uint64_t slots, overlaps, after_zero, zeros, late_us;
static uint32_t least_us = UINT32_MAX;
static uint32_t longest_us; /* that a function of the port takes */
static bool zeroed, by_chance, real;
/* In place of interrupts that are off. */
static pthread_mutex_t interrupts = PTHREAD_MUTEX_INITIALIZER;

/* Return a number below one, xorshift64. */
static uint32_t chance(uint32_t below)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return below == 0u ? 0u : (uint32_t)(seed >> 33) % below;
}

/* Let a function of the port take its time, and ask for zero now and then. */
static void take_time(void)
{
    played_us += chance(longest_us + 1u);
    if (by_chance && chance(4000) == 0u) {
        zeros++;
        zeroed = true;
        st_zero(&board, "fault");
    }
}

static uint64_t now_us(void *self)
{
    (void)self;
    if (real) {
        struct timespec now;
        (void)clock_gettime(CLOCK_MONOTONIC, &now);
        return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
    }
    played_us += chance(2);
    return played_us;
}

static uint32_t draw(void *self)
{
    static uint32_t count;
    (void)self;
    count++;
    /* A session begins: what was asked for before ends none. */
    (void)pthread_mutex_lock(&interrupts);
    zeroed = false;
    (void)pthread_mutex_unlock(&interrupts);
    return count;
}

static void send(void *self, const uint8_t *data, size_t size)
{
    (void)self;
    (void)data;
    (void)size;
    take_time();
}

static uint64_t pulse(void *self, const st_pulse *given)
{
    (void)self;
    take_time();
    (void)pthread_mutex_lock(&interrupts);
    const bool may = st_may_pulse(&board);
    const uint64_t begun_us = now_us(NULL);
    if (may) {
        after_zero += zeroed ? 1u : 0u;
        overlaps += begun_us < free_us ? 1u : 0u;
        if (slots > 0u && begun_us >= free_us && begun_us - free_us < least_us) {
            least_us = (uint32_t)(begun_us - free_us);
        }
        late_us += begun_us - given->start_us;
        /* After a recharge phase another session may begin before the end of its scan. */
        free_us = begun_us + given->width_us
                  + (given->slot == ST_NOTHING ? ST_MIN_DISCHARGE_US : given->rest_us);
        slots++;
    }
    (void)pthread_mutex_unlock(&interrupts);
    take_time();
    return may ? begun_us : ST_NOT_BEGUN_US;
}

static void shorted(void *self, const char *reason)
{
    (void)self;
    (void)reason;
}

static int16_t force_mn(void *self)
{
    (void)self;
    take_time();
    return 1000;
}

static uint16_t volts(void *self)
{
    (void)self;
    take_time();
    return 1;
}

static bool emergency_open(void *self)
{
    (void)self;
    take_time();
    return false;
}

static const st_port PORT = { NULL, now_us, draw, send, pulse, shorted, force_mn, volts, NULL,
                              emergency_open };

static st_config configure(void)
{
    st_config config = { 0 };
    config.electrodes = ELECTRODES;
    config.output = ST_WEIGHTED;
    config.features = ST_KERNELS | ST_RECHARGE | ST_FORCE | ST_VOLTAGE | ST_SWITCH;
    config.most_slots = 64;
    config.ramp_ms = 500;
    config.most_kernels = 4;
    config.packet_bytes = PACKET;
    config.kernel_bytes = sizeof kernels;
    for (unsigned index = 0; index < ST_BUFFERS; index++) {
        config.buffer[index] = buffer[index];
    }
    config.kernels = kernels;
    config.kernel_at = kernel_at;
    config.sums = sums;
    config.current_ua = current_ua;
    config.pulse_ua = pulse_ua;
    config.each = each;
    config.volts = volts_kept;
    config.name = "checks";
    return config;
}

/* Begin a session as a host does. */
static void begin(void)
{
    st_hang_up(&board);
    talk.session = 1;
    talk.number = 0;
    st_talk_begin(&talk, &board, 7);
    st_talk_limits(&talk, &board);
}

/* Send a scan of some slots with voltages, and a recharge phase now and then; wait for its end. */
static void send_scan(uint32_t number)
{
    uint8_t payload[512];
    const uint32_t count = 1u + chance(40);
    const bool back = chance(4) == 0u;
    const uint32_t width_us = 20u + chance(60);
    const uint32_t ua = chance(30);
    uint8_t *at = st_put_u32(payload, 5000u + chance(20000));
    at = st_put_u16(st_put_u16(at, 1u + chance(3)), 200);
    *at++ = back ? 3 : 1;
    *at++ = 1;
    /* Now and then longer than it takes to begin another session. */
    at = st_put_u16(st_put_u16(at, width_us), chance(8) == 0u ? 500u : 20u + chance(40));
    if (back) {
        at = st_put_u16(st_put_u16(st_put_u16(st_put_u16(st_put_u16(at, 500), 0), 0), 0), 0);
    }
    *at++ = ST_CURRENTS;
    *at++ = 0;
    at = st_put_u16(at, count);
    for (uint32_t slot = 0; slot < count; slot++) {
        const uint32_t sign = slot % 2u == 0u ? ua : 0u - ua;
        at = st_put_u16(st_put_u16(st_put_u16(st_put_u16(st_put_u16(at, 0), sign), 0u - sign), 0), 0);
    }
    st_talk_say(&talk, &board, ST_SEQUENCE, number, payload, (size_t)(at - payload));
    while (board.running != NULL) {
        st_advance(&board);
        if (chance(8) == 0u) {
            st_talk_say(&talk, &board, ST_HEARTBEAT, 0, NULL, 0);
        }
    }
}

static int check_times(uint64_t wanted, uint64_t first)
{
    const st_config config = configure();
    uint32_t number = 0;
    uint64_t dull = 0;
    seed = first * 2654435761u + 1u;
    if (st_init(&board, &config, &PORT) != NULL) {
        return 1;
    }
    by_chance = true;
    while (slots < wanted && dull < 100000u) {
        const uint64_t before = slots;
        /* As if the board had just been switched on: its least times are another port's. */
        longest_us = chance(4) == 0u ? 0u : chance(501);
        board.port_us = UINT32_MAX;
        if (board.refusing != 0u || number > 200u || !st_may_pulse(&board)) {
            begin();
            number = 0;
        }
        send_scan(++number);
        dull = slots > before ? 0u : dull + 1u;
    }
    (void)printf("%llu slots, %llu overlaps, %llu after %llu zeros, least beyond the rest %u us, "
                 "%llu us late in the mean\n",
                 (unsigned long long)slots, (unsigned long long)overlaps,
                 (unsigned long long)after_zero, (unsigned long long)zeros, least_us,
                 (unsigned long long)(slots == 0u ? 0u : late_us / slots));
    return slots < wanted || overlaps > 0u || after_zero > 0u || zeros == 0u ? 1 : 0;
}

static bool ended;

static void *interrupt(void *with)
{
    struct timespec wait = { 0, 0 };
    uint64_t own = 88172645463325252u;
    (void)with;
    while (!__atomic_load_n(&ended, __ATOMIC_SEQ_CST)) {
        own ^= own << 13;
        own ^= own >> 7;
        own ^= own << 17;
        wait.tv_nsec = (long)(own % 10000000u);
        (void)nanosleep(&wait, NULL);
        /* An interrupt runs whole, and not while interrupts are off. */
        (void)pthread_mutex_lock(&interrupts);
        st_zero(&board, "fault");
        zeroed = true;
        zeros++;
        (void)pthread_mutex_unlock(&interrupts);
    }
    return NULL;
}

static int check_interrupts(uint64_t milliseconds)
{
    st_config config = configure();
    pthread_t thread;
    seed = 1;
    real = true;
    if (st_init(&board, &config, &PORT) != NULL) {
        return 1;
    }
    const uint64_t end_us = now_us(NULL) + 1000u * milliseconds;
    (void)pthread_create(&thread, NULL, interrupt, NULL);
    while (now_us(NULL) < end_us) {
        begin();
        for (uint32_t number = 1; number < 20u && board.refusing == 0u; number++) {
            send_scan(number);
        }
    }
    __atomic_store_n(&ended, true, __ATOMIC_SEQ_CST);
    (void)pthread_join(thread, NULL);
    (void)printf("%llu slots, %llu overlaps, %llu after %llu zeros\n", (unsigned long long)slots,
                 (unsigned long long)overlaps, (unsigned long long)after_zero,
                 (unsigned long long)zeros);
    return slots == 0u || overlaps > 0u || after_zero > 0u || zeros == 0u ? 1 : 0;
}

static uint64_t still_us(void *self)
{
    (void)self;
    return 5;
}

static uint64_t coarse_us(void *self)
{
    (void)self;
    return now_us(NULL) / 1000u * 1000u;
}

/* Say what st_init returns of a board with one field left out, and whether it then does anything. */
static void check_one(const char *name, const st_config *config, const st_port *port)
{
    const char *wrong = st_init(&board, config, port);
    begin();
    (void)printf("%s: %s%s\n", name, wrong == NULL ? "as safe as can be" : wrong,
                 wrong != NULL && board.session.live ? " BUT IT BEGINS" : "");
}

#define LEFT_OUT(field)                                    \
    do {                                                   \
        st_config config = configure();                    \
        memset(&config.field, 0, sizeof config.field);     \
        check_one("config." #field, &config, &PORT);       \
    } while (0)
#define NOT_THERE(field)                                   \
    do {                                                   \
        const st_config config = configure();              \
        st_port port = PORT;                               \
        port.field = NULL;                                 \
        check_one("port." #field, &config, &port);         \
    } while (0)

static int check_init(void)
{
    seed = 1;
    LEFT_OUT(electrodes);
    LEFT_OUT(output);
    LEFT_OUT(features);
    LEFT_OUT(most_slots);
    LEFT_OUT(compliance_v);
    LEFT_OUT(ramp_ms);
    LEFT_OUT(most_kernels);
    LEFT_OUT(packet_bytes);
    LEFT_OUT(kernel_bytes);
    LEFT_OUT(buffer[0]);
    LEFT_OUT(buffer[1]);
    LEFT_OUT(buffer[2]);
    LEFT_OUT(kernels);
    LEFT_OUT(kernel_at);
    LEFT_OUT(sums);
    LEFT_OUT(current_ua);
    LEFT_OUT(pulse_ua);
    LEFT_OUT(each);
    LEFT_OUT(volts);
    LEFT_OUT(name);
    NOT_THERE(now_us);
    NOT_THERE(draw);
    NOT_THERE(send);
    NOT_THERE(pulse);
    NOT_THERE(shorted);
    NOT_THERE(force_mn);
    NOT_THERE(volts);
    NOT_THERE(left_pc);
    NOT_THERE(emergency_open);
    const st_config config = configure();
    st_port port = PORT;
    port.now_us = still_us;
    check_one("a clock that stands", &config, &port);
    port.now_us = coarse_us;
    check_one("a clock of milliseconds", &config, &port);
    check_one("nothing left out", &config, &PORT);
    return 0;
}

int main(int count, char **words)
{
    const char *what = count > 1 ? words[1] : "";
    const uint64_t number = count > 2 ? strtoull(words[2], NULL, 10) : 100000u;
    if (strcmp(what, "times") == 0) {
        return check_times(number, count > 3 ? strtoull(words[3], NULL, 10) : 1u);
    }
    if (strcmp(what, "interrupts") == 0) {
        return check_interrupts(number);
    }
    return strcmp(what, "init") == 0 ? check_init() : 2;
}
