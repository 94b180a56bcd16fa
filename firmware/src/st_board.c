/* The state machine: packets in, answers out. */
#include <string.h>

#include "st_inside.h"

/* Send the next packet of the session; uses the port's line. */
void st_send(st_board *board, uint8_t kind, uint32_t about, const uint8_t *payload, size_t size)
{
    st_session *session = &board->session;
    session->said++;
    st_send_packet(board, kind, session->number, session->said, session->taken, about, payload,
                   size);
}

/* Acknowledge the last sequence, with the time at which it began. */
void st_acknowledge(st_board *board)
{
    const uint64_t start_us = board->last_start_us;
    uint8_t payload[8];
    (void)st_put_u32(st_put_u32(payload, (uint32_t)start_us), (uint32_t)(start_us >> 32));
    st_send(board, ST_ACK, (uint32_t)board->last_number, payload, sizeof payload);
}

#define NAK_BYTES 14u

/* Write the payload of a NAK. */
static void put_refusal(uint8_t payload[NAK_BYTES], const st_refusal *refusal)
{
    payload[0] = refusal->reason;
    payload[1] = refusal->rule;
    uint8_t *at = st_put_u16(st_put_u16(payload + 2, refusal->slot), refusal->electrode);
    (void)st_put_u32(st_put_u32(at, (uint32_t)refusal->value), (uint32_t)refusal->allowed);
}

/* Send a NAK of this session. */
static void send_refusal(st_board *board, uint32_t about, const st_refusal *refusal)
{
    uint8_t payload[NAK_BYTES];
    put_refusal(payload, refusal);
    st_send(board, ST_NAK, about, payload, sizeof payload);
}

/* Send a NAK that names a reason, and no rule. */
static void refuse(st_board *board, uint32_t about, uint8_t reason)
{
    const st_refusal refusal = { reason, ST_RULE_NONE, ST_NOTHING, ST_NOTHING, 0, 0 };
    send_refusal(board, about, &refusal);
}

/* Answer a packet that is not taken by a NAK, while a session is live. */
static void refuse_foreign(st_board *board, uint8_t reason)
{
    if (board->session.live) {
        refuse(board, 0, reason);
    }
}

/* Return what is wrong with what a board is, or NULL. */
static const char *wrong_config(const st_config *config)
{
    const unsigned known = ST_VOLTAGE | ST_FORCE | ST_RECHARGE | ST_KERNELS | ST_SWITCH;
    if (config->electrodes == 0u || config->electrodes == ST_NOTHING) {
        return "config.electrodes is missing";
    }
    if (config->output < ST_WEIGHTED || config->output > ST_ONE_AGAINST_ALL) {
        return "config.output is missing: ST_WEIGHTED, ST_THREE_STATE or ST_ONE_AGAINST_ALL";
    }
    if ((config->features & ~known) != 0u
        || (config->output != ST_WEIGHTED && (config->features & ST_RECHARGE) != 0u)) {
        return "config.features has one that this board cannot have";
    }
    if (config->most_slots == 0u || config->most_slots > ST_MAX_SLOTS) {
        return "config.most_slots is not from 1 to 8000";
    }
    if (config->packet_bytes < 64u + 8u * (uint32_t)config->electrodes) {
        return "config.packet_bytes is below 64 + 8 for each electrode";
    }
    for (unsigned index = 0; index < ST_BUFFERS; index++) {
        for (unsigned other = 0; other < index; other++) {
            if (config->buffer[index] == config->buffer[other]) {
                return "config.buffer has the same memory twice";
            }
        }
        if (config->buffer[index] == NULL) {
            return "config.buffer is missing";
        }
    }
    if (config->current_ua == NULL || config->pulse_ua == NULL || config->each == NULL
        || config->current_ua == config->pulse_ua) {
        return "config.current_ua, pulse_ua or each is missing, or two are the same";
    }
    if ((config->features & ST_KERNELS) != 0u
        && (config->kernels == NULL || config->kernel_at == NULL || config->sums == NULL
            || config->kernel_bytes == 0u || config->most_kernels == 0u)) {
        return "with ST_KERNELS config.kernels, kernel_at, sums, kernel_bytes or most_kernels is "
               "missing";
    }
    if ((config->features & ST_VOLTAGE) != 0u && config->volts == NULL) {
        return "with ST_VOLTAGE config.volts is missing";
    }
    return config->name == NULL ? "config.name is missing" : NULL;
}

/* Return what is wrong with a port, or NULL. */
static const char *wrong_port(const st_config *config, const st_port *port)
{
    if (port->now_us == NULL || port->draw == NULL || port->send == NULL || port->pulse == NULL
        || port->shorted == NULL) {
        return "port.now_us, draw, send, pulse or shorted is missing";
    }
    if ((config->features & ST_FORCE) != 0u && port->force_mn == NULL) {
        return "with ST_FORCE port.force_mn is missing";
    }
    if ((config->features & ST_VOLTAGE) != 0u && port->volts == NULL) {
        return "with ST_VOLTAGE port.volts is missing";
    }
    if ((config->features & ST_SWITCH) != 0u && port->emergency_open == NULL) {
        return "with ST_SWITCH port.emergency_open is missing";
    }
    return NULL;
}

#define CLOCK_READS 1000000u
#define CLOCK_STEPS 8u
#define CLOCK_STEP_US 50u

/* Return what is wrong with the port's clock, or NULL; waits for a few of its steps. */
static const char *wrong_clock(const st_port *port)
{
    uint64_t before_us = port->now_us(port->self);
    uint64_t least_us = UINT64_MAX;
    unsigned steps = 0;
    for (uint32_t read = 0; read < CLOCK_READS && steps < CLOCK_STEPS; read++) {
        const uint64_t now_us = port->now_us(port->self);
        if (now_us < before_us) {
            return "port.now_us goes back";
        }
        if (now_us > before_us) {
            least_us = now_us - before_us < least_us ? now_us - before_us : least_us;
            before_us = now_us;
            steps++;
        }
    }
    if (steps < CLOCK_STEPS) {
        return "port.now_us stands still";
    }
    return least_us > CLOCK_STEP_US ? "port.now_us goes in steps above 50 us" : NULL;
}

/* Check what is given, clear the board's memory, short all electrodes; waits for steps of the
 * clock. */
const char *st_init(st_board *board, const st_config *config, const st_port *port)
{
    (void)memset(board, 0, sizeof *board);
    board->config = *config;
    board->port = *port;
    board->last_number = -1;
    board->refusing = ST_NOT_BEGUN;
    board->port_us = UINT32_MAX;
    if (port->shorted != NULL) {
        port->shorted(port->self, "start");
    }
    const char *wrong = wrong_config(config);
    wrong = wrong == NULL ? wrong_port(config, port) : wrong;
    wrong = wrong == NULL && !st_is_played(board) ? wrong_clock(port) : wrong;
    if (wrong == NULL) {
        if (config->ramp_ms == 0u) {
            board->config.ramp_ms = ST_SAFE_RAMP_MS;
        }
        (void)memset(config->each, 0, config->electrodes * sizeof *config->each);
        st_session_init(board);
        board->right = true;
    }
    return wrong;
}

/* Read the port's clock into the board; one that goes back stands still. */
uint64_t st_clock(st_board *board)
{
    const uint64_t now_us = board->port.now_us(board->port.self);
    board->now_us = now_us > board->now_us ? now_us : board->now_us;
    return board->now_us;
}

/* What interrupts write is one pointer, read and written whole. */
bool st_may_pulse(const st_board *board)
{
    return __atomic_load_n(&board->zero_reason, __ATOMIC_SEQ_CST) == NULL;
}

/* Leave a reason for the core to find and short all electrodes; touches nothing else of the board.
 * */
void st_zero(st_board *board, const char *reason)
{
    /* Called once more before the core has seen it, also by the port's own shorted. */
    const char *why = reason != NULL ? reason : "zero";
    if (st_may_pulse(board)) {
        __atomic_store_n(&board->zero_reason, why, __ATOMIC_SEQ_CST);
        if (board->port.shorted != NULL) {
            board->port.shorted(board->port.self, why);
        }
    }
}

/* End the session if an interrupt or the switch says so; may short and send. */
bool st_may_go_on(st_board *board)
{
    const st_port *port = &board->port;
    const char *reason = __atomic_load_n(&board->zero_reason, __ATOMIC_SEQ_CST);
    if (reason != NULL) {
        st_end_session(board, ST_NOT_BEGUN, reason);
        __atomic_store_n(&board->zero_reason, NULL, __ATOMIC_SEQ_CST);
    }
    board->open = (board->config.features & ST_SWITCH) != 0u && port->emergency_open(port->self);
    if (board->open && board->refusing == 0u) {
        st_end_session(board, ST_EMERGENCY, "emergency");
        refuse(board, 0, ST_EMERGENCY);
    }
    return board->refusing == 0u;
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
            refuse(board, dropped->number, ST_SILENCE);
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
        const uint64_t due_us = board->ready ? sequence->next_us : sequence->end_us;
        next_us = due_us < next_us ? due_us : next_us;
    }
    return next_us;
}

/* -- packets ------------------------------------------------------------------------------- */

/* Answer HELLO by CAPABILITIES, unless it is old or a session is live. */
static void offer(st_board *board, const st_message *hello)
{
    const st_config *config = &board->config;
    uint8_t payload[128];
    uint64_t session = 0;
    if (!st_offers(board, hello, &session)) {
        refuse_foreign(board, ST_FOREIGN);
        return;
    }
    uint8_t *at = st_put_u16(payload, config->electrodes);
    *at++ = (uint8_t)(config->output - ST_WEIGHTED);
    *at++ = config->features;
    at = st_put_u16(st_put_u16(at, ST_MAX_CURRENT_UA), config->most_slots);
    at = st_put_u16(st_put_u16(at, ST_SILENCE_US / 1000u), config->compliance_v);
    at = st_put_u32(st_put_u32(at, config->kernel_bytes), config->packet_bytes);
    at = st_put_u16(at, config->most_kernels);
    const size_t head = (size_t)(at - payload);
    size_t name = strlen(config->name);
    if (name > sizeof payload - head) {
        name = sizeof payload - head;
    }
    (void)memcpy(at, config->name, name);
    st_send_packet(board, ST_CAPABILITIES, session, 0, 0, hello->number, payload, head + name);
}

/* Answer STATUS by REPORT. */
static void report(st_board *board, uint32_t about)
{
    const st_books *books = &board->books;
    uint8_t payload[53];
    uint8_t *at = st_put_u32(st_put_u32(payload, books->sequences), books->slots);
    at = st_put_u32(st_put_u32(at, (uint32_t)books->pulses), (uint32_t)(books->pulses >> 32));
    at = st_put_u32(at, books->violations);
    at = st_put_u32(st_put_u32(at, books->max_current_ua), books->max_charge_pc);
    at = st_put_u32(at, board->port.left_pc != NULL ? board->port.left_pc(board->port.self) : 0u);
    *at++ = (uint8_t)((board->running != NULL ? 1u : 0u) + (board->waiting != NULL ? 1u : 0u));
    at = st_put_u32(st_put_u32(at, books->old_packets), books->foreign_packets);
    at = st_put_u32(at, books->second_net_pc);
    at = st_put_u32(at, (uint32_t)st_upward(board->exposure.flowing_us, 1000000u));
    at = st_put_u32(at, (uint32_t)st_upward(st_exposure_most_pc(board), 1000000u));
    st_send(board, ST_REPORT, about, payload, (size_t)(at - payload));
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

/* Check a SEQUENCE by all rules; begin it, let it wait, or refuse it. */
static void accept(st_board *board, const st_message *message)
{
    const uint32_t number = message->about;
    st_refusal refusal = { 0, ST_RULE_NONE, ST_NOTHING, ST_NOTHING, 0, 0 };
    if (board->refusing != 0u) {
        refuse(board, number, board->open ? ST_EMERGENCY : board->refusing);
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
        refuse(board, number, ST_BUSY);
        return;
    }
    st_sequence *sequence = &board->sequence[board->running == &board->sequence[0] ? 1 : 0];
    /* What waits begins when the scan at hand is over. */
    const uint64_t start_us = board->running != NULL ? board->running->end_us : board->now_us;
    if (!st_read_sequence(board, message->payload, message->size, sequence, &refusal)
        || !st_obeys(board, sequence, start_us, &refusal)) {
        board->books.violations++;
        send_refusal(board, number, &refusal);
        return;
    }
    if (!st_may_go_on(board)) {
        refuse(board, number, board->refusing);
        return;
    }
    st_rise_note(board, sequence, start_us);
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

/* Refuse to open a session while the emergency switch is open: the same BEGIN may come again. */
static void refuse_begin(st_board *board, const st_message *message)
{
    const st_refusal refusal = { ST_EMERGENCY, ST_RULE_NONE, ST_NOTHING, ST_NOTHING, 0, 0 };
    uint8_t payload[NAK_BYTES];
    put_refusal(payload, &refusal);
    st_send_packet(board, ST_NAK, message->session, 0, 0, message->number, payload, sizeof payload);
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
        refuse_begin(board, message);
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
        report(board, message->number);
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
        refuse(board, 0, ST_GARBLED);
    }
    if (st_head(board, &message) && (message.kind == ST_SEQUENCE || message.kind == ST_LOAD)
        && now_us - board->stream.packet_us <= ST_LONGEST_US
        && st_judge(board, &message, board->stream.packet_us) == 0u) {
        board->heard_us = now_us;
    }
}

/* Short and end the session; the board says nothing more by itself. */
void st_hang_up(st_board *board)
{
    st_advance(board);
    if (board->right && board->refusing != ST_NOT_BEGUN) {
        st_end_session(board, ST_NOT_BEGUN, "host closed");
    }
    board->greeted = false;
}
