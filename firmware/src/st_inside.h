/* What the parts of the core have in common. */
#ifndef ST_INSIDE_H
#define ST_INSIDE_H

#include "st_board.h"

enum {
    ST_HELLO = 0x01, ST_SEQUENCE = 0x02, ST_HEARTBEAT = 0x03, ST_STOP = 0x04, ST_STATUS = 0x05,
    ST_BEGIN = 0x06, ST_LIMITS = 0x07, ST_LOAD = 0x08, ST_CAPABILITIES = 0x81, ST_ACK = 0x82,
    ST_NAK = 0x83, ST_ALIVE = 0x84, ST_REPORT = 0x85, ST_STOPPED = 0x86, ST_VOLTAGES = 0x87,
    ST_BEGUN = 0x88, ST_LIMITED = 0x89, ST_KEPT = 0x8A
};
enum {
    ST_BUSY = 1, ST_MALFORMED = 2, ST_UNSAFE = 3, ST_NOT_BEGUN = 4, ST_SILENCE = 5,
    ST_GARBLED = 6, ST_OLD = 7, ST_FOREIGN = 8, ST_EMERGENCY = 9
};
enum {
    ST_RULE_NONE = 0, ST_RULE_LIMITS, ST_RULE_SLOTS, ST_RULE_PERIOD, ST_RULE_WIDTH,
    ST_RULE_DISCHARGE, ST_RULE_FIT, ST_RULE_DUTY, ST_RULE_KIND, ST_RULE_KERNEL, ST_RULE_SUM,
    ST_RULE_BALANCE, ST_RULE_CURRENT, ST_RULE_TOTAL, ST_RULE_CHARGE, ST_RULE_STATES, ST_RULE_MEAN,
    ST_RULE_INTENSITY, ST_RULE_RISE, ST_RULE_RECHARGE, ST_RULE_PERIOD_PULSES,
    ST_RULE_SECOND_PULSES, ST_RULE_SECOND_CHARGE, ST_RULE_SECOND_NET, ST_RULE_SECOND_STARTS,
    ST_RULE_SESSION_TIME, ST_RULE_SESSION_CHARGE, ST_RULE_READY, ST_RULE_PART
};
enum { ST_MEASURES = 1u, ST_RECHARGES = 2u, ST_MORE = 4u, ST_GOES_ON = 8u }; /* flags of a sequence */
enum { ST_POINTS = 0, ST_SUM = 1, ST_CURRENTS = 2, ST_STATES = 3 };

#define ST_HEAD_BYTES 23u /* of a decoded packet before its payload */
#ifndef ST_SILENCE_US /* another only in tests */
#define ST_SILENCE_US 100000u
#endif
#define ST_ALIVE_US 20000u
#define ST_LATE_US 250000u
#define ST_LONGEST_US 1000000u
#define ST_FULL 65535u

/* The project's ceilings: the host may ask for less, never for more. */
#define ST_MAX_CURRENT_UA 5000u
#define ST_MAX_TOTAL_UA 10000u
#define ST_MAX_SOURCE_UA 5000u /* of a board with one source: all of it may find one electrode */
#define ST_MAX_WIDTH_US 200u
#define ST_MAX_CHARGE_PC 500000u
#define ST_MIN_PERIOD_US 5000u
#define ST_MAX_SLOTS 8000u /* their charge adds up in 32 bits */
#define ST_MIN_DISCHARGE_US 20u
#define ST_MAX_DUTY_PERCENT 80u
#define ST_MAX_MEAN_UA 500u
#define ST_BURST_US 40000u
#define ST_MAX_FELT_UA 2500u
#define ST_MAX_FELT_HZ 1500u
#define ST_MAX_SECOND_PC 500000000u
#define ST_MAX_NET_PC 50000000u
#define ST_MAX_SESSION_S 3600u
#define ST_MAX_SESSION_UC 1800000u
#define ST_MIN_RAMP_MS 500u
#define ST_SAFE_RAMP_MS 10000u /* where host or board names none */
#define ST_LEVEL_KEPT_US 15000000u
#define ST_BUCKET_US 50000u
#define ST_MAX_RECHARGE_UA 500u
#define ST_MAX_RECHARGE_US 20000u
#define ST_MAX_RECHARGE_PC 2000000u
#define ST_LOST_PC 2000000u /* what a recharge may leave, as sequences may be lost on the way */
#define ST_CATCH_UP_US 150000u
#define ST_RISE_LEEWAY 2u
#define ST_STRENGTH 4u /* multiple of a pulse's share of a full one that its strength is at most */

static inline uint16_t st_u16(const uint8_t *at)
{
    return (uint16_t)(at[0] | ((unsigned)at[1] << 8));
}

static inline uint32_t st_u32(const uint8_t *at)
{
    return (uint32_t)st_u16(at) | ((uint32_t)st_u16(at + 2) << 16);
}

static inline int16_t st_i16(const uint8_t *at)
{
    const uint16_t bits = st_u16(at);
    return (int16_t)(bits < 0x8000u ? (int32_t)bits : (int32_t)bits - 0x10000);
}

static inline uint8_t *st_put_u16(uint8_t *at, uint32_t value)
{
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
    return at + 2;
}

static inline uint8_t *st_put_u32(uint8_t *at, uint32_t value)
{
    return st_put_u16(st_put_u16(at, value), value >> 16);
}

static inline uint32_t st_magnitude(int16_t value)
{
    return (uint32_t)(value < 0 ? -(int32_t)value : (int32_t)value);
}

/* st_frame.c */
uint32_t st_crc32(uint32_t crc, const uint8_t *data, size_t size);
void st_send_packet(st_board *board, uint8_t kind, uint64_t session, uint32_t number,
                    uint32_t heard, uint32_t about, const uint8_t *payload, size_t size);
/* Take one byte; return whether it completes a packet, which then is in the stream's buffer. */
bool st_take_byte(st_board *board, uint8_t byte, uint64_t now_us, uint32_t *size);
/* Read the head of the packet that comes in; return whether all of it is there. */
bool st_head(st_board *board, st_message *message);
void st_parse(const uint8_t *body, uint32_t size, st_message *message);

/* st_answers.c */
/* Send the next packet of the session. */
void st_send(st_board *board, uint8_t kind, uint32_t about, const uint8_t *payload, size_t size);
/* Acknowledge the last sequence: when it began, by the port's clock. */
void st_acknowledge(st_board *board);
void st_send_refusal(st_board *board, uint32_t about, const st_refusal *refusal);
/* Send a NAK that names a reason, and no rule. */
void st_send_reason(st_board *board, uint32_t about, uint8_t reason);
/* Refuse a BEGIN while the emergency switch is open. */
void st_refuse_begin(st_board *board, const st_message *message);
void st_send_capabilities(st_board *board, uint64_t session, uint32_t number);
void st_send_report(st_board *board, uint32_t about);

/* st_engine.c */
/* Return whether time is set by a test. */
static inline bool st_is_played(const st_board *board)
{
#ifdef ST_FOR_TESTS
    return board->config.played;
#else
    (void)board;
    return false;
#endif
}
/* Read the port's clock, which never goes back. */
uint64_t st_clock(st_board *board);
/* If st_zero was called, or the emergency switch is open, end the session; return whether one is
 * still live. */
bool st_may_go_on(st_board *board);
void st_begin_sequence(st_board *board, st_sequence *sequence, uint64_t start_us);
/* Begin the pulses that are due in the pass at hand, and end no pass. */
void st_execute_pulses(st_board *board);
/* Return when the pass at hand is over: with its slots, if the next part of its scan waits. */
uint64_t st_pass_end_us(const st_board *board);
/* Do all that is due. */
void st_execute(st_board *board);
/* Short all electrodes and end the session; what comes after is refused so. */
void st_end_session(st_board *board, uint8_t refusing, const char *reason);

/* st_session.c */
void st_session_init(st_board *board);
bool st_offers(st_board *board, const st_message *hello, uint64_t *session);
/* Return whether a BEGIN may open a session. */
bool st_may_begin(const st_board *board, const st_message *begin);
bool st_begins(st_board *board, const st_message *begin);
uint8_t st_judge(const st_board *board, const st_message *message, uint64_t began_us);
uint8_t st_take(st_board *board, const st_message *message, uint64_t began_us);
void st_note_alive(st_board *board, uint64_t now_us);

/* st_sha256.c */
void st_sha256_begin(st_sha256 *hash);
void st_sha256_add(st_sha256 *hash, const uint8_t *data, size_t size);
/* Write the first 16 bytes of the hash. */
void st_sha256_end(st_sha256 *hash, uint8_t digest[ST_IDENTITY_BYTES]);

/* st_kept_kernels.c */
#define ST_LOAD_HEAD (ST_IDENTITY_BYTES + 8u) /* of a payload of KERNELS */
void st_keep_take(st_board *board, const uint8_t *payload, uint32_t size);
/* Compute what shows the host of this session that the whole table is here. */
void st_keep_prove(st_board *board);
void st_add_kernel(const st_board *board, uint32_t kernel, uint32_t amplitude);
uint16_t st_kernel_site(const st_board *board, uint32_t kernel);

/* st_sequence_packet.c */
bool st_read_sequence(const st_board *board, const uint8_t *data, uint32_t size,
                      st_sequence *sequence, st_refusal *refusal);
/* Write a refusal by a rule; return false. */
bool st_refuse(st_refusal *refusal, uint8_t rule, uint32_t slot, uint32_t electrode,
               uint64_t value, uint64_t allowed);
void st_first_slot(const st_sequence *sequence, st_place *place);
void st_next_slot(const st_sequence *sequence, st_place *place, uint16_t electrodes);
uint16_t st_shape_width(const st_sequence *sequence, uint8_t shape);
uint16_t st_shape_discharge(const st_sequence *sequence, uint8_t shape);
/* Write a slot's currents or states; return its site. */
uint16_t st_slot_currents(st_board *board, const st_sequence *sequence, const st_place *place,
                          int16_t *current_ua, uint16_t *source_ua);

/* st_limits.c */
bool st_limits_take(st_board *board, const uint8_t *payload, uint32_t size);
/* Return the largest strength of a sequence that starts then. */
uint32_t st_rise_allowed(const st_board *board, const st_sequence *sequence, uint64_t start_us);
/* Return what a sequence's intensity amounts to, by the charge of its strongest pulse. */
uint16_t st_strength(const st_limits *limits, uint32_t intensity, uint32_t peak_pc);
void st_rise_note(st_board *board, const st_sequence *sequence, uint64_t start_us);

/* st_rules.c */
/* Note a sequence that obeys all rules: for the parts of its scan that follow, and for the rise. */
void st_scan_note(st_board *board, const st_sequence *sequence, uint64_t start_us);
/* Check a sequence that starts then; write its load. */
bool st_obeys(st_board *board, st_sequence *sequence, uint64_t start_us, st_refusal *refusal);

/* st_exposure.c */
/* Return the load that a pass of a sequence puts on an electrode. */
st_load *st_load_of(const st_board *board, const st_sequence *sequence, uint32_t electrode);
/* Check the second and the session with a sequence that starts then. */
bool st_exposure_obeys(st_board *board, const st_sequence *sequence, uint64_t start_us,
                       st_refusal *refusal);
void st_exposure_begin_session(st_board *board);
/* Enter the pass that begins. */
void st_exposure_begin(st_board *board, const st_sequence *sequence);
/* Move the pass that is over, or cut off then, into the last second. */
void st_exposure_end(st_board *board, const st_sequence *sequence, uint64_t until_us);
/* Return the most charge of either sign through an electrode in the session. */
uint64_t st_exposure_most_pc(const st_board *board);

/* Return whether a sequence is a further part of the scan before it. */
static inline bool st_goes_on(const st_sequence *sequence)
{
    return (sequence->flags & ST_GOES_ON) != 0u;
}

static inline uint32_t st_least(uint32_t one, uint32_t other)
{
    return one < other ? one : other;
}

/* Return a quotient, rounded up. */
static inline uint64_t st_upward(uint64_t value, uint64_t by)
{
    return (value + by - 1u) / by;
}

#endif
