/* The state machine: packets in, answers out. */
#include <string.h>

#include "st_inside.h"

/* Answer a packet that is not taken by a NAK, while a session is live. */
static void refuse_foreign(st_board *board, uint8_t reason)
{
    if (board->session.live) {
        st_send_reason(board, 0, reason);
    }
}

/* Do what is due: pulses, silence, ALIVE; may call every function of the port. */
void st_advance(st_board *board)
{
    if (!board->right) {
        return;
    }
    board->executed_us = st_clock(board);
    (void)st_may_go_on(board);
    st_execute(board);
    const uint64_t now_us = st_clock(board);
    if (now_us >= board->heard_us + ST_SILENCE_US && board->refusing == 0u) {
        const st_sequence *dropped = board->waiting;
        st_end_session(board, ST_SILENCE, "silence");
        if (dropped != NULL) {
            st_send_reason(board, dropped->number, ST_SILENCE);
        }
    }
    if (board->greeted && now_us - board->alive_us >= ST_ALIVE_US) {
        uint8_t force[2] = { 0, 0 };
        board->alive_us = now_us;
        if ((board->config.features & ST_FORCE) != 0u) {
            (void)st_put_u16(force, (uint16_t)board->port.force_mn(board->port.self));
        }
        st_send(board, ST_ALIVE, 0, force, sizeof force);
        st_note_alive(board, now_us);
    }
}

/* Return when something is due; reads only. */
uint64_t st_next_us(const st_board *board)
{
    uint64_t next_us = board->greeted ? board->alive_us + ST_ALIVE_US : UINT64_MAX;
    if (!st_may_pulse(board)) {
        return 0;
    }
    if (board->refusing == 0u && board->heard_us + ST_SILENCE_US < next_us) {
        next_us = board->heard_us + ST_SILENCE_US;
    }
    if (board->running != NULL) {
        const st_sequence *sequence = board->running;
        const uint64_t due_us = board->ready ? sequence->next_us : st_pass_end_us(board);
        next_us = due_us < next_us ? due_us : next_us;
    }
    return next_us;
}

/* -- packets ------------------------------------------------------------------------------- */

/* Answer HELLO by CAPABILITIES, unless it is old or a session is live. */
static void offer(st_board *board, const st_message *hello)
{
    uint64_t session = 0;
    if (st_offers(board, hello, &session)) {
        st_send_capabilities(board, session, hello->number);
    } else {
        refuse_foreign(board, ST_FOREIGN);
    }
}

/* Take bytes of kernels unless a sequence is made of them now, and answer KEPT. */
static void answer_kept(st_board *board, const st_message *message)
{
    const st_keep *keep = &board->keep;
    uint8_t payload[2u * ST_IDENTITY_BYTES + 5u];
    /* What a sequence is made of stays as it is until that is over. */
    if (message->size >= ST_LOAD_HEAD && board->running == NULL && board->refusing == 0u) {
        st_keep_take(board, message->payload, message->size);
    }
    st_keep_prove(board);
    (void)memcpy(payload, keep->identity, ST_IDENTITY_BYTES);
    uint8_t *at = st_put_u32(payload + ST_IDENTITY_BYTES, keep->received);
    *at++ = keep->whole ? 1u : 0u;
    (void)memcpy(at, keep->proof, ST_IDENTITY_BYTES);
    st_send(board, ST_KEPT, message->number, payload, sizeof payload);
}

/* Return a buffer that neither a packet nor a sequence is in. */
static uint8_t free_buffer(const st_board *board)
{
    uint8_t buffer = 0;
    while (buffer == board->stream.packet
           || (board->running != NULL && buffer == board->running->buffer)
           || (board->waiting != NULL && buffer == board->waiting->buffer)) {
        buffer++;
    }
    return buffer;
}

/* Return when a sequence would begin: after the pass at hand; a further part of a scan after the
 * slots of the part before. */
static uint64_t start_of(const st_board *board, const st_sequence *sequence)
{
    const st_sequence *running = board->running;
    if (running == NULL) {
        return board->now_us;
    }
    if (!st_goes_on(sequence)) {
        return running->end_us;
    }
    const uint64_t over_us = running->start_us + running->busy_us;
    return over_us > board->now_us ? over_us : board->now_us;
}

/* Check a SEQUENCE by all rules; begin it, let it wait, or refuse it. */
static void accept(st_board *board, const st_message *message)
{
    const uint32_t number = message->about;
    st_refusal refusal = { 0, ST_RULE_NONE, ST_NOTHING, ST_NOTHING, 0, 0 };
    if (board->refusing != 0u) {
        st_send_reason(board, number, board->open ? ST_EMERGENCY : board->refusing);
        return;
    }
    if ((int64_t)number == board->last_number) {
        if (board->last_begun) {
            st_acknowledge(board);
        }
        return;
    }
    if ((int64_t)number < board->last_number) {
        board->books.old_packets++;
        refuse_foreign(board, ST_OLD);
        return;
    }
    if (board->waiting != NULL) {
        st_send_reason(board, number, ST_BUSY);
        return;
    }
    st_sequence *sequence = &board->sequence[board->running == &board->sequence[0] ? 1 : 0];
    uint64_t start_us = 0;
    bool obeys = st_read_sequence(board, message->payload, message->size, sequence, &refusal);
    if (obeys) {
        start_us = start_of(board, sequence);
        obeys = st_obeys(board, sequence, start_us, &refusal);
    }
    if (!obeys) {
        board->books.violations++;
        st_send_refusal(board, number, &refusal);
        return;
    }
    if (!st_may_go_on(board)) {
        st_send_reason(board, number, board->refusing);
        return;
    }
    st_scan_note(board, sequence, start_us);
    sequence->start_us = board->now_us;
    sequence->number = number;
    sequence->buffer = board->stream.packet;
    board->last_number = number;
    board->last_begun = false;
    if (board->running == NULL) {
        st_begin_sequence(board, sequence, st_clock(board));
    } else {
        board->waiting = sequence;
    }
    /* The sequence stays where it came in; the next packet comes into another buffer. */
    board->stream.packet = free_buffer(board);
    st_execute(board);
}

/* Open the session that BEGIN has brought: no limits, no level, no dose. */
static void begin(st_board *board)
{
    board->refusing = 0;
    board->last_number = -1;
    board->last_begun = false;
    board->greeted = true;
    board->limits.given = false;
    (void)memset(&board->ramp, 0, sizeof board->ramp);
    (void)memset(&board->scan, 0, sizeof board->scan);
    (void)memset(board->keep.proof, 0, sizeof board->keep.proof);
    board->keep.proved = false;
    st_exposure_begin_session(board);
}

/* Do what a packet asks for, and answer it. */
static void answer(st_board *board, const st_message *message, uint64_t began_us, uint64_t now_us)
{
    if (message->kind == ST_HELLO) {
        offer(board, message);
        return;
    }
    if (message->kind == ST_BEGIN && board->open && st_may_begin(board, message)) {
        st_refuse_begin(board, message);
        return;
    }
    if (message->kind == ST_BEGIN && st_begins(board, message)) {
        begin(board);
    } else {
        const uint8_t reason = st_take(board, message, began_us);
        if (reason != 0u) {
            refuse_foreign(board, reason);
            return;
        }
    }
    board->heard_us = now_us;
    switch (message->kind) {
    case ST_BEGIN:
        if (board->refusing == 0u) {
            st_send(board, ST_BEGUN, message->number, NULL, 0);
        }
        break;
    case ST_SEQUENCE:
        accept(board, message);
        break;
    case ST_STOP:
        st_end_session(board, ST_NOT_BEGUN, "stop");
        st_send(board, ST_STOPPED, message->number, NULL, 0);
        break;
    case ST_STATUS:
        st_send_report(board, message->number);
        break;
    case ST_LIMITS: {
        const uint8_t taken = st_limits_take(board, message->payload, message->size) ? 1u : 0u;
        st_send(board, ST_LIMITED, message->number, &taken, 1);
        break;
    }
    case ST_LOAD:
        answer_kept(board, message);
        break;
    default:
        break;
    }
}

/* Take bytes as they come, and answer the packets that are whole. */
void st_feed(st_board *board, const uint8_t *data, size_t size)
{
    const uint32_t garbled = board->books.framing_errors;
    st_message message;
    uint32_t length = 0;
    if (!board->right) {
        return;
    }
    st_advance(board);
    const uint64_t now_us = board->now_us;
    for (size_t index = 0; index < size; index++) {
        const uint64_t began_us = board->stream.packet_us;
        if (st_take_byte(board, data[index], now_us, &length)) {
            st_parse(board->config.buffer[board->stream.packet], length, &message);
            answer(board, &message, began_us, now_us);
        }
    }
    if (board->books.framing_errors > garbled && board->greeted) {
        st_send_reason(board, 0, ST_GARBLED);
    }
    if (st_head(board, &message) && (message.kind == ST_SEQUENCE || message.kind == ST_LOAD)
        && now_us - board->stream.packet_us <= ST_LONGEST_US
        && st_judge(board, &message, board->stream.packet_us) == 0u) {
        board->heard_us = now_us;
    }
}

/* Short and end the session; the board sends nothing more unasked. */
void st_hang_up(st_board *board)
{
    st_advance(board);
    if (board->right && board->refusing != ST_NOT_BEGUN) {
        st_end_session(board, ST_NOT_BEGUN, "host closed");
    }
    board->greeted = false;
}
