/* The board behind a pseudo-terminal, with books as the Python emulator keeps them. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/random.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "st_memory.h"
#include "st_skin.h"

#define LONGEST_STEP_US 10000u /* how long the process may be away before its time stands still */
#define WRITE_EVERY_US 50000u
#define FIRST_HOST_US 8000000u

typedef struct {
    st_board board;
    st_memory memory;
    int line;
    const char *folder, *state, *reason;
    FILE *delivered;
    uint64_t now_us, real_us, stood_still_us, written_us;
    uint32_t unsafe;
    double zero_after_ms;
    st_skin skin;
    st_driven driven;
} host;

static volatile sig_atomic_t ended;

static void end(int number)
{
    (void)number;
    ended = 1;
}

static uint64_t monotonic_us(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

/* Hardware is never kept waiting; what plays it must not take its own absence for silence. */
static void step_clock(host *self)
{
    const uint64_t real_us = monotonic_us();
    uint64_t step_us = real_us - self->real_us;
    self->real_us = real_us;
    if (step_us > LONGEST_STEP_US) {
        const uint64_t away_us = step_us - LONGEST_STEP_US;
        uint64_t *shifted[] = { &self->board.ramp.since_us, &self->board.scan.before.since_us,
                                &self->board.scan.start_us };
        self->stood_still_us += away_us;
        step_us = LONGEST_STEP_US;
        /* On the skin that time has passed. */
        for (unsigned each = 0; each < 3u; each++) {
            *shifted[each] -= *shifted[each] < away_us ? *shifted[each] : away_us;
        }
    }
    self->now_us += step_us;
}

static uint64_t now_us(void *self)
{
    const host *own = self;
    return own->now_us;
}

static uint32_t draw(void *self)
{
    uint32_t bits = 0;
    (void)self;
    while (bits == 0u && getrandom(&bits, sizeof bits, 0) != (ssize_t)sizeof bits) {
    }
    return bits == 0u ? 1u : bits;
}

static void send(void *self, const uint8_t *data, size_t size)
{
    host *own = self;
    while (size > 0u) {
        const ssize_t sent = write(own->line, data, size);
        if (sent <= 0) {
            return;
        }
        data += sent;
        size -= (size_t)sent;
    }
}

static void record(host *own, const st_pulse *pulse)
{
    const uint32_t electrodes = own->board.config.electrodes;
    const bool switched = own->board.config.output != ST_WEIGHTED;
    static int32_t current_ua[ST_MOST_ELECTRODES];
    static float charge_uc[ST_MOST_ELECTRODES];
    static const uint8_t nothing[4u * ST_MOST_ELECTRODES];
    static double amps[ST_MOST_ELECTRODES];
    uint32_t poles[2] = { 0, 0 };
    double peak_ua = 0;
    for (uint32_t each = 0; each < electrodes; each++) {
        poles[0] += pulse->current_ua[each] > 0;
        poles[1] += pulse->current_ua[each] < 0;
    }
    for (uint32_t each = 0; each < electrodes; each++) {
        double ua = pulse->current_ua[each];
        if (switched && ua != 0) {
            ua = ua > 0 ? (double)pulse->source_ua / poles[0] : -(double)pulse->source_ua / poles[1];
        }
        amps[each] = ua * 1e-6;
        current_ua[each] = (int32_t)lrint(ua);
        charge_uc[each] = (float)(ua * pulse->width_us * 1e-6);
        peak_ua = fmax(peak_ua, fabs(ua));
    }
    st_skin_pulse(&own->skin, amps, electrodes, pulse);
    if (pulse->slot != ST_NOTHING) {
        own->unsafe += peak_ua > 5000 || peak_ua * pulse->width_us > 500000 || pulse->width_us > 200;
    } else {
        own->unsafe += peak_ua > 500 || peak_ua * pulse->width_us > 2e6 || pulse->width_us > 20000;
    }
    if (own->delivered != NULL) {
        const int64_t time_us = (int64_t)pulse->start_us;
        (void)fwrite(&pulse->number, 4, 1, own->delivered);
        (void)fwrite(&pulse->slot, 2, 1, own->delivered);
        (void)fwrite(&pulse->site, 2, 1, own->delivered);
        (void)fwrite(&time_us, 8, 1, own->delivered);
        (void)fwrite(current_ua, 4, electrodes, own->delivered);
        (void)fwrite(charge_uc, 4, electrodes, own->delivered);
        /* Volts and residual charge of each electrode are not kept. */
        (void)fwrite(nothing, 4, electrodes, own->delivered);
    }
}

static uint64_t pulse(void *self, const st_pulse *pulse)
{
    host *own = self;
    own->state = "driving";
    st_driven_pulse(&own->driven, &own->board, pulse);
    record(own, pulse);
    return pulse->start_us;
}

static void shorted(void *self, const char *reason)
{
    host *own = self;
    own->state = "shorted";
    own->reason = reason;
    st_driven_until(&own->driven, own->board.config.electrodes,
                    strcmp(reason, "end") == 0 ? UINT64_MAX : own->board.executed_us);
    if (strcmp(reason, "end") != 0) {
        own->zero_after_ms = (double)(own->now_us - own->board.heard_us) / 1000.0;
    }
}

static uint16_t volts(void *self)
{
    const host *own = self;
    return (uint16_t)lrint(100.0 * own->skin.source_v);
}

static uint32_t left_pc(void *self)
{
    const host *own = self;
    return (uint32_t)lrint(1e12 * own->skin.left_c);
}

static void write_state(host *own)
{
    const st_books *books = &own->board.books;
    char path[4096];
    char temporary[4096 + 8];
    if (own->folder == NULL) {
        return;
    }
    (void)fflush(own->delivered);
    (void)snprintf(path, sizeof path, "%s/state.json", own->folder);
    (void)snprintf(temporary, sizeof temporary, "%s.new", path);
    FILE *file = fopen(temporary, "w");
    if (file == NULL) {
        return;
    }
    (void)fprintf(file,
                  "{\"electrodes\": %u, \"sequences\": %u, \"slots\": %u, \"pulses\": %llu, "
                  "\"violations\": %u, \"unsafe\": %u, \"framing_errors\": %u, "
                  "\"old_packets\": %u, \"foreign_packets\": %u, \"max_current_ma\": %.3f, "
                  "\"max_charge_uc\": %.6f, \"max_net_charge_uc\": %.6f, \"max_volts\": %.2f, "
                  "\"recharges\": %u, \"state\": \"%s\", \"reason\": \"%s\", "
                  "\"zero_after_ms\": %.3f, \"stood_still_ms\": %.3f, \"passed_uc\": [",
                  own->board.config.electrodes, books->sequences, books->slots,
                  (unsigned long long)books->pulses, books->violations, own->unsafe,
                  books->framing_errors, books->old_packets, books->foreign_packets,
                  books->max_current_ua / 1e3, books->max_charge_pc / 1e6, 1e6 * own->skin.left_c,
                  own->skin.most_v, books->recharges, own->state, own->reason, own->zero_after_ms,
                  (double)own->stood_still_us / 1000.0);
    for (uint32_t each = 0; each < own->board.config.electrodes; each++) {
        (void)fprintf(file, each == 0u ? "%.9g" : ", %.9g",
                      (double)own->driven.pc[each] * 1e-6);
    }
    (void)fprintf(file, "]}\n");
    (void)fclose(file);
    (void)rename(temporary, path);
}

static int open_line(void)
{
    struct termios raw;
    const int line = posix_openpt(O_RDWR | O_NOCTTY);
    if (line < 0 || grantpt(line) != 0 || unlockpt(line) != 0 || tcgetattr(line, &raw) != 0) {
        return -1;
    }
    cfmakeraw(&raw);
    (void)tcsetattr(line, TCSANOW, &raw);
    (void)fcntl(line, F_SETFL, O_NONBLOCK);
    /* Opened and closed once, so that it counts as without a host from the start. */
    (void)close(open(ptsname(line), O_RDWR | O_NOCTTY));
    return line;
}

static void serve(host *own, uint64_t linger_us)
{
    uint8_t data[65536];
    bool hosted = false;
    uint64_t host_us = FIRST_HOST_US;
    while (ended == 0) {
        struct pollfd line = { own->line, POLLIN, 0 };
        const uint64_t next_us = st_next_us(&own->board);
        const uint64_t wait_us = next_us > own->now_us ? next_us - own->now_us : 0u;
        const struct timespec wait = { 0, (long)(1000u * (wait_us > 2000u ? 2000u : wait_us)) };
        (void)ppoll(&line, 1, &wait, NULL);
        step_clock(own);
        const ssize_t size = (line.revents & POLLIN) != 0 ? read(own->line, data, sizeof data) : 0;
        const bool here = (line.revents & POLLHUP) == 0;
        if (size > 0) {
            st_feed(&own->board, data, (size_t)size);
        } else {
            st_advance(&own->board);
        }
        if (hosted && !here) {
            st_hang_up(&own->board);
            write_state(own);
        }
        hosted = here;
        if (hosted) {
            host_us = own->now_us;
        } else if (own->now_us > host_us + linger_us) {
            break;
        } else {
            (void)usleep(1000);
        }
        if (own->now_us - own->written_us > WRITE_EVERY_US) {
            write_state(own);
            own->written_us = own->now_us;
        }
    }
    if (ended != 0) {
        st_zero(&own->board, "signal");
    }
}

static const char *option(int count, char **words, const char *name, const char *usual)
{
    const size_t length = strlen(name);
    for (int index = 1; index < count; index++) {
        if (strncmp(words[index], name, length) == 0 && words[index][length] == '=') {
            usual = words[index] + length + 1;
        }
    }
    return usual;
}

int main(int count, char **words)
{
    static host own;
    st_config config;
    const st_port port = { &own, now_us, draw, send, pulse, shorted, NULL, volts, left_pc, NULL };
    const char *kind = option(count, words, "--output", "weighted");
    const long electrodes = strtol(option(count, words, "--electrodes", "64"), NULL, 10);
    const long ramp_ms = strtol(option(count, words, "--ramp-ms", "500"), NULL, 10);
    const double linger_s = strtod(option(count, words, "--linger", "1e9"), NULL);
    const uint8_t output = strcmp(kind, "three-state") == 0     ? ST_THREE_STATE
                           : strcmp(kind, "one-against-all") == 0 ? ST_ONE_AGAINST_ALL
                                                                  : ST_WEIGHTED;
    if (count > 1 && strcmp(words[1], "--help") == 0) {
        (void)puts("st_host [--electrodes=N] [--output=weighted|three-state|one-against-all]\n"
                   "        [--books=FOLDER] [--linger=S] [--ramp-ms=N; 0 only in tests]\n"
                   "The board behind a pseudo-terminal, whose name is printed.");
        return 0;
    }
    if (electrodes < 1 || electrodes > (long)ST_MOST_ELECTRODES || ramp_ms < 0 || ramp_ms > 10000) {
        (void)fputs("error: from 1 to 1024 electrodes, and a ramp from 0 to 10000 ms\n", stderr);
        return 2;
    }
    own.folder = option(count, words, "--books", NULL);
    own.state = "shorted";
    own.reason = "start";
    own.line = open_line();
    if (own.line < 0) {
        perror("error: no pseudo-terminal");
        return 2;
    }
    if (own.folder != NULL) {
        char path[4096];
        (void)snprintf(path, sizeof path, "%s/delivered.bin", own.folder);
        own.delivered = fopen(path, "ab");
        if (own.delivered == NULL) {
            perror("error: books");
            return 2;
        }
    }
    /* Hardware is never kept waiting; nor is this, where the system allows it. */
    const struct sched_param first = { .sched_priority = 1 };
    (void)sched_setscheduler(0, SCHED_FIFO, &first);
    (void)signal(SIGTERM, end);
    (void)signal(SIGPIPE, SIG_IGN);
    own.real_us = monotonic_us();
    st_configure(&config, &own.memory, (uint16_t)electrodes, output, (uint16_t)ramp_ms);
    config.features |= ST_VOLTAGE;
    config.compliance_v = (uint16_t)ST_COMPLIANCE_V;
    const char *wrong = st_init(&own.board, &config, &port);
    if (wrong != NULL) {
        (void)fprintf(stderr, "error: %s\n", wrong);
        return 2;
    }
    write_state(&own);
    (void)puts(ptsname(own.line));
    (void)fflush(stdout);
    serve(&own, (uint64_t)(linger_s * 1e6));
    write_state(&own);
    return 0;
}
