/* Core of a SmartTouch board: the link protocol of version 5 between bytes and pulses.
 *
 * It knows no hardware, has no heap and no clock: a port gives it memory, bytes and the time in
 * microseconds, and makes pulses. docs/reference/link.md is the specification.
 * Currents are positive cathodic.
 */
#ifndef ST_BOARD_H
#define ST_BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define ST_VERSION 5u
#define ST_NOTHING 0xFFFFu    /* no slot or electrode; as a slot, the recharge phase */
#define ST_BUFFERS 3u         /* a packet that comes in, a sequence that executes, one that waits */
#define ST_HOSTS 8u           /* hosts whose HELLOs are told apart */
#define ST_ALIVES 14u         /* packets ALIVE whose age is known */
#define ST_BUCKETS 21u        /* of 50 ms: the last second, whose beginning lies within the first */
#define ST_STARTS 201u        /* passes that begin in a second, at 5 ms each */
#define ST_IDENTITY_BYTES 16u /* of a table of kernels, and of the proof that it is here */
#define ST_NO_RAMP 0xFFFFu    /* only in tests: intensity may be full at once */

enum { ST_WEIGHTED = 0, ST_THREE_STATE = 1, ST_ONE_AGAINST_ALL = 2 };
enum { ST_VOLTAGE = 1, ST_FORCE = 2, ST_RECHARGE = 4, ST_KERNELS = 8, ST_SWITCH = 16 };

/* A pulse that begins now. The port ends it after width_us by a timer of its own, and shorts all
 * electrodes then; so the core may be late, and a pulse never is too long. */
typedef struct {
    uint64_t start_us;
    uint32_t number;           /* of the sequence */
    uint16_t slot;             /* ST_NOTHING: the recharge phase */
    uint16_t site;
    uint16_t width_us;
    uint16_t source_ua;        /* of a switched board */
    uint32_t rest_us;          /* at least so long all electrodes stay shorted after it */
    const int16_t *current_ua; /* (E,) of a weighted board; of a switched one states 1, -1, 0 */
} st_pulse;

/* What a port does for the core. */
typedef struct {
    void *self;
    uint32_t (*draw)(void *self); /* random bits, or a counter that survives switching off; not 0 */
    void (*send)(void *self, const uint8_t *data, size_t size);
    void (*pulse)(void *self, const st_pulse *pulse);
    void (*shorted)(void *self, const char *reason); /* all electrodes shorted, now */
    int16_t (*force_mn)(void *self);
    /* With ST_VOLTAGE: the source's voltage at the end of the last pulse, in 10 mV. Asked for when
     * that pulse is over. */
    uint16_t (*volts)(void *self);
    /* The largest charge that was left on an electrode after a discharge; NULL if nobody knows. */
    uint32_t (*left_pc)(void *self);
    /* With ST_SWITCH: whether the emergency switch is open. NULL counts as open. */
    bool (*emergency_open)(void *self);
} st_port;

/* What a pass of a sequence does to one electrode. */
typedef struct {
    int64_t net_pc;
    uint32_t charge_pc; /* of either sign */
    uint32_t felt;      /* pulses strong enough to be felt */
} st_load;

/* What the core knows of one electrode: limits of the session, and what has passed through it. */
typedef struct {
    st_load load[2];       /* of a pass of each of the two sequences */
    int64_t driven_pc;     /* net since switched on; what flows back is not counted */
    int64_t net_pc;        /* of the passes that began in the session */
    uint64_t session_pc;   /* of either sign, in the session */
    uint32_t limit_pc;     /* of a pulse */
    uint16_t limit_ua, felt_ua;
    uint32_t charge_pc[ST_BUCKETS]; /* the last second: what ended within each bucket */
    int32_t sum_pc[ST_BUCKETS];
    int32_t most_pc[ST_BUCKETS], least_pc[ST_BUCKETS]; /* of all sums that end with the bucket */
    uint16_t felt[ST_BUCKETS];
} st_electrode;

/* What a board is, and the memory it has; all of it is the port's. */
typedef struct {
    uint16_t electrodes;
    uint8_t output;
    uint8_t features;      /* ST_VOLTAGE, ST_FORCE, ST_RECHARGE, ST_KERNELS, ST_SWITCH */
    uint16_t most_slots;
    uint16_t compliance_v;
    uint16_t ramp_ms;      /* least time from zero to full intensity; 500 at least */
    uint16_t most_kernels;
    bool real_time;        /* a slot that is late moves all that follow it, so that no discharge is
                              shorter than asked; false only where time is played */
    uint32_t packet_bytes; /* of each buffer */
    uint32_t kernel_bytes;
    uint8_t *buffer[ST_BUFFERS];
    uint8_t *kernels;
    uint32_t *kernel_at;   /* (most_kernels,) */
    int32_t *sums;         /* (E,) */
    int16_t *current_ua;   /* (E,) */
    st_electrode *each;    /* (E,) */
    uint8_t *volts;        /* (2 most_slots,), with ST_VOLTAGE */
    const char *name;
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
    uint32_t period_us, total_ua, width_us, full_ua, rounding_ua, full_us;
    uint32_t ramp_us; /* 0 only in tests */
    uint32_t session_s, session_uc, duty_percent, usual_us;
    bool given;
} st_limits;

/* Rise of intensity: while passes with current are scheduled, from a time on. */
typedef struct {
    uint64_t since_us, span_us;
    uint32_t level, strength; /* strength: of the last sequence with current */
} st_ramp;

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
    st_exposure exposure;
    st_sequence sequence[2];
    st_sequence *running, *waiting;
    uint64_t heard_us, alive_us, executed_us;
    int64_t last_number;
    uint64_t last_start_us;
    bool last_begun, greeted;
    bool open; /* the emergency switch, when it was looked at last */
    uint8_t refusing; /* a reason, 0 if sequences are taken */
} st_board;

/* Begin, with all electrodes shorted. */
void st_init(st_board *board, const st_config *config, const st_port *port);
/* Take bytes of the host. */
void st_feed(st_board *board, const uint8_t *data, size_t size, uint64_t now_us);
/* Do all that is due; put all at zero if the host is silent. In real time pulses begin here, and at
 * the start of st_feed: read the clock just before. */
void st_advance(st_board *board, uint64_t now_us);
/* When there is something to do at the latest, if no byte comes and no switch opens. */
uint64_t st_next_us(const st_board *board);
/* The host has closed the line. */
void st_hang_up(st_board *board, uint64_t now_us);
/* Short all electrodes and end the session, for example where the port finds a fault. */
void st_zero(st_board *board, const char *reason);

#endif
