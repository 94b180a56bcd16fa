/* Core of a SmartTouch board: the link protocol of version 5 between bytes and pulses.
 *
 * It uses no hardware and no heap: a port gives it memory, bytes and a clock in microseconds,
 * and makes pulses. firmware/PROTOCOL.md is the specification.
 * Currents are positive cathodic. A field that is left at zero has its safest value, or st_init
 * reports that it is missing.
 */
#ifndef ST_BOARD_H
#define ST_BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define ST_VERSION 5u
#define ST_NOTHING 0xFFFFu    /* no slot or electrode; as a slot, the recharge phase */
#define ST_BUFFERS 3u         /* a packet that comes in, a sequence that executes, one that waits */
#define ST_HOSTS 8u           /* hosts whose HELLOs are distinguished */
#define ST_ALIVES 14u         /* packets ALIVE whose age is known */
#define ST_BUCKETS 21u        /* of 50 ms: the last second, whose beginning lies within the first */
#define ST_STARTS 201u        /* passes that begin in a second, at 5 ms each */
#define ST_IDENTITY_BYTES 16u /* of a table of kernels, and of the proof that it is here */
#define ST_NOT_BEGUN_US UINT64_MAX /* returned by a port's pulse that did not begin */

#ifdef __cplusplus
extern "C" {
#endif

enum { ST_WEIGHTED = 1, ST_THREE_STATE = 2, ST_ONE_AGAINST_ALL = 3 };
enum { ST_VOLTAGE = 1, ST_FORCE = 2, ST_RECHARGE = 4, ST_KERNELS = 8, ST_SWITCH = 16 };

/* A pulse to begin now. */
typedef struct {
    uint64_t start_us;         /* when it was due: now, or a little before */
    uint32_t number;           /* of the sequence */
    uint16_t slot;             /* ST_NOTHING: the recharge phase */
    uint16_t site;
    uint16_t width_us;
    uint16_t source_ua;        /* of a switched board */
    uint32_t rest_us;          /* at least so long all electrodes stay shorted after it */
    const int16_t *current_ua; /* (E,) of a weighted board; of a switched one states 1, -1, 0 */
} st_pulse;

/* What a port does for the core. Every function may call st_zero. */
typedef struct {
    void *self;
    /* Microseconds since switched on: in steps of 50 at most, never back; st_longer_us extends 32
     * bits. */
    uint64_t (*now_us)(void *self);
    uint32_t (*draw)(void *self); /* random bits, or a counter that survives switching off; not 0 */
    void (*send)(void *self, const uint8_t *data, size_t size);
    /* Set all outputs, start the timer that ends the pulse after width_us with all electrodes
     * shorted, and switch the current on. Return when it was switched on, by now_us: however long
     * all this takes, the rest after the pulse is kept. With interrupts off from there on, ask
     * st_may_pulse right before the current is switched on; if not, leave all electrodes shorted
     * and return ST_NOT_BEGUN_US. */
    uint64_t (*pulse)(void *self, const st_pulse *pulse);
    /* Short all electrodes, now; also called from an interrupt if st_zero is. The reason is a word
     * for a log. */
    void (*shorted)(void *self, const char *reason);
    int16_t (*force_mn)(void *self); /* with ST_FORCE */
    /* With ST_VOLTAGE: the source's voltage at the end of the last pulse, in 10 mV. Asked for when
     * that pulse is over. */
    uint16_t (*volts)(void *self);
    /* The largest charge that was left on an electrode after a discharge; NULL if unknown. */
    uint32_t (*left_pc)(void *self);
    bool (*emergency_open)(void *self); /* with ST_SWITCH */
} st_port;

/* What a pass of a sequence does to one electrode. */
typedef struct {
    int64_t net_pc;
    uint32_t charge_pc; /* of either sign */
    uint32_t felt;      /* pulses strong enough to be felt */
} st_load;

/* What the core keeps of one electrode: limits of the session, and what has passed through it. */
typedef struct {
    st_load load[2];       /* of a pass of each of the two sequences */
    int64_t net_pc;        /* of the passes that began in the session */
    uint64_t session_pc;   /* of either sign, in the session */
    uint32_t limit_pc;     /* of a pulse */
    uint16_t limit_ua, felt_ua;
    uint32_t scan_pc;      /* of either sign, in the parts of a scan that were accepted */
    uint32_t charge_pc[ST_BUCKETS]; /* the last second: what ended within each bucket */
    int32_t sum_pc[ST_BUCKETS];
    int32_t most_pc[ST_BUCKETS], least_pc[ST_BUCKETS]; /* of all sums that end with the bucket */
    uint16_t felt[ST_BUCKETS], scan_felt;
} st_electrode;

/* What a board is, and the memory it has; all of it is the port's. */
typedef struct {
    uint16_t electrodes;
    uint8_t output;
    uint8_t features;      /* ST_VOLTAGE, ST_FORCE, ST_RECHARGE, ST_KERNELS, ST_SWITCH */
    uint16_t most_slots;
    uint16_t compliance_v;
    uint16_t ramp_ms;      /* least time from zero to full intensity, from 500; 0: 10,000 */
    uint16_t most_kernels;
    uint32_t packet_bytes; /* of each buffer; 64 + 8 E at least */
    uint32_t kernel_bytes;
    uint8_t *buffer[ST_BUFFERS];
    uint8_t *kernels;
    uint32_t *kernel_at;   /* (most_kernels,) */
    int32_t *sums;         /* (E,), with ST_KERNELS */
    int16_t *current_ua;   /* (E,), of a slot that is checked */
    int16_t *pulse_ua;     /* (E,), of the next pulse */
    st_electrode *each;    /* (E,) */
    uint8_t *volts;        /* (2 most_slots,), with ST_VOLTAGE */
    const char *name;
#ifdef ST_FOR_TESTS
    bool played;  /* time is set by the port: what is due begins then, however late */
    bool no_ramp; /* intensity may be full at once */
#endif
} st_config;

typedef struct {
    uint32_t sequences, slots, violations, framing_errors, old_packets, foreign_packets;
    uint32_t max_current_ua, max_charge_pc, recharges, second_net_pc;
    uint64_t pulses;
} st_books;

typedef struct {
    uint8_t reason, rule;
    uint16_t slot, electrode;
    int32_t value, allowed;
} st_refusal;

typedef struct {
    uint32_t period_us, total_ua, width_us, full_ua, rounding_ua;
    uint32_t ramp_us; /* 0 only in tests */
    uint32_t session_s, session_uc, duty_percent, usual_us;
    bool given;
} st_limits;

/* Rise of intensity: while passes with current are scheduled, from a time on. */
typedef struct {
    uint64_t since_us, span_us;
    uint32_t level, strength; /* strength: of the last sequence with current */
} st_ramp;

/* A scan that comes in parts: what the rules need of the parts that were accepted. */
typedef struct {
    bool open;         /* the last of them announces more */
    uint16_t intensity;
    uint32_t period_us, busy_us, flowing_us, peak_pc;
    uint64_t start_us; /* when it was to begin, as the rules count */
    uint64_t end_us;   /* of the pass that ended last */
    st_ramp before;    /* the rise before the scan */
} st_scan;

/* Passes of a sequence that begin within one bucket of time. */
typedef struct {
    uint64_t bucket;
    uint32_t first, last;
} st_passes;

/* The last second and the session, over all electrodes. */
typedef struct {
    uint64_t bucket;   /* the newest */
    uint64_t start_us[ST_STARTS];
    uint32_t starts, start_at;
    uint64_t flowing_us; /* passes with slots, in the session */
    st_passes passes[ST_BUCKETS];
} st_exposure;

/* A place in a sequence: the slot that comes next. */
typedef struct {
    uint32_t at;         /* of its body in the payload */
    uint32_t group_left; /* slots of the group, with this one */
    uint32_t pairs;      /* of a sum */
    uint32_t slot;
    uint8_t kind, shape;
} st_place;

typedef struct {
    const uint8_t *data; /* payload */
    uint32_t size, number, period_us, body_at, slots;
    uint32_t left;       /* scans, with the one at hand */
    uint16_t times, intensity, recharge_us;
    uint16_t strength;   /* what its intensity amounts to; 0 without current */
    uint32_t busy_us, flowing_us; /* of its slots and recharge phase, and of their current */
    uint32_t peak_pc;    /* strongest pulse of its scan, so far */
    uint8_t shapes, flags, buffer;
    uint32_t measured;   /* slots of the scan whose voltage is known */
    uint64_t start_us, next_us, end_us;
    st_place place;
    bool recharged;
} st_sequence;

typedef struct {
    uint8_t kind, version;
    uint32_t number, heard, about;
    uint64_t session;
    const uint8_t *payload;
    uint32_t size;
} st_message;

typedef struct {
    /* of the stream */
    uint32_t filled, block_left;
    uint8_t code, packet;
    bool started, broken;
    uint64_t packet_us;
} st_stream;

typedef struct {
    uint32_t half, last, count;
} st_host;

typedef struct {
    uint64_t number;
    uint32_t challenge, taken, said;
    bool live;
    st_host hosts[ST_HOSTS];
    uint8_t host_count;
    uint64_t alive_us[ST_ALIVES];
    uint32_t alive_number[ST_ALIVES];
    uint8_t alive_count, alive_at;
} st_session;

typedef struct {
    uint32_t state[8];
    uint8_t block[64];
    uint64_t size;
} st_sha256;

typedef struct {
    uint8_t identity[ST_IDENTITY_BYTES], proof[ST_IDENTITY_BYTES];
    uint32_t size, received, count;
    bool whole, proved; /* proved: the proof is of the present session */
    st_sha256 hash;     /* of the bytes that are there */
} st_keep;

typedef struct {
    st_config config;
    st_port port;
    st_books books;
    st_stream stream;
    st_session session;
    st_keep keep;
    st_limits limits;
    st_ramp ramp;
    st_scan scan;
    st_exposure exposure;
    st_sequence sequence[2];
    st_sequence *running, *waiting;
    uint64_t heard_us, alive_us, executed_us;
    int64_t last_number;
    uint64_t last_start_us;
    bool last_begun, greeted;
    bool open; /* the emergency switch, when it was looked at last */
    uint8_t refusing; /* a reason, 0 if sequences are taken */
    uint64_t now_us;  /* by the clock when it was read last */
    st_pulse next;    /* the next pulse of the running sequence, if it is ready */
    bool ready;
    uint32_t next_ua, next_poles; /* of the next pulse: the strongest; electrodes with current */
    uint64_t free_us; /* end of the rest after the last pulse, whatever session it was of */
    uint32_t port_us; /* least time that the port's pulse has taken */
    bool right;       /* st_init has found nothing wrong */
    const char *zero_reason; /* of a zero that the core has not seen yet; written by interrupts */
} st_board;

/* Begin, with all electrodes shorted. Return what is wrong with what is given, in one sentence, or
 * NULL; a board with something wrong does nothing at all but short. */
const char *st_init(st_board *board, const st_config *config, const st_port *port);
/* Take bytes of the host. */
void st_feed(st_board *board, const uint8_t *data, size_t size);
/* Do all that is due; put all at zero if the host is silent. */
void st_advance(st_board *board);
/* Return when there is something to do at the latest, if no byte comes and no switch opens. */
uint64_t st_next_us(const st_board *board);
/* End the session, as the host has closed the line. */
void st_hang_up(st_board *board);
/* Short all electrodes and end the session, for example where the port finds a fault. May be called
 * from an interrupt, and from every function of the port: no pulse begins after it until the host
 * begins another session. */
void st_zero(st_board *board, const char *reason);
/* Return whether a pulse may begin: for the port's pulse to ask, see there. */
bool st_may_pulse(const st_board *board);
/* Return a clock of 32 bits, in microseconds, extended by what it was before: to be called at least
 * every 35 minutes. One that seems to go back stands still. */
static inline uint64_t st_longer_us(uint64_t before_us, uint32_t now_us)
{
    const uint32_t passed_us = now_us - (uint32_t)before_us;
    return passed_us < 0x80000000u ? before_us + passed_us : before_us;
}

#ifdef __cplusplus
}
#endif

#endif
