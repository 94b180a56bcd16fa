/* Sessions: which packets are taken, and how many are not. */
#include <string.h>

#include "st_inside.h"

/* Forget all sessions, and draw a challenge. */
void st_session_init(st_board *board)
{
    st_session *session = &board->session;
    (void)memset(session, 0, sizeof *session);
    session->challenge = board->port.draw(board->port.self);
}

/* Return what is known of a host, or NULL. */
static st_host *find_host(st_session *session, uint32_t half)
{
    for (uint8_t index = 0; index < session->host_count; index++) {
        if (session->hosts[index].half == half) {
            return &session->hosts[index];
        }
    }
    return NULL;
}

/* Count the HELLOs of hosts that began no session, and forget these hosts. */
static void count_foreign(st_board *board)
{
    st_session *session = &board->session;
    for (uint8_t index = 0; index < session->host_count; index++) {
        board->books.foreign_packets += session->hosts[index].count;
    }
    session->host_count = 0;
}

/* Remember a host by its half of the session. */
static void remember(st_session *session, uint32_t half, uint32_t number, uint32_t count)
{
    st_host *host = &session->hosts[session->host_count];
    host->half = half;
    host->last = number;
    host->count = count;
    session->host_count++;
}

/* Return whether HELLO is answered, and with which session. */
bool st_offers(st_board *board, const st_message *hello, uint64_t *number)
{
    st_session *session = &board->session;
    const uint32_t half = (uint32_t)hello->session;
    if (session->live) {
        board->books.foreign_packets++;
        return false;
    }
    if (hello->version == ST_VERSION) {
        st_host *host = find_host(session, half);
        if (hello->number <= (host == NULL ? 0u : host->last)) {
            board->books.old_packets++;
            return false;
        }
        if (host == NULL) {
            if (session->host_count == ST_HOSTS) {
                count_foreign(board);
            }
            remember(session, half, hello->number, 1);
        } else {
            host->last = hello->number;
            host->count++;
        }
    }
    *number = ((uint64_t)session->challenge << 32) | half;
    return true;
}

/* Return whether BEGIN bears the challenge while no session is live. */
bool st_may_begin(const st_board *board, const st_message *begin)
{
    const st_session *session = &board->session;
    return !session->live && session->challenge != 0u && begin->version == ST_VERSION
           && (uint32_t)begin->session != 0u
           && (uint32_t)(begin->session >> 32) == session->challenge;
}

/* Open a session if BEGIN may, and draw a new challenge. */
bool st_begins(st_board *board, const st_message *begin)
{
    st_session *session = &board->session;
    const uint32_t half = (uint32_t)begin->session;
    if (!st_may_begin(board, begin)) {
        return false;
    }
    st_host *host = find_host(session, half);
    if (host != NULL) {
        host->count = 0;
    }
    count_foreign(board);
    remember(session, half, begin->number, 0);
    session->challenge = board->port.draw(board->port.self);
    session->number = begin->session;
    session->live = true;
    session->taken = begin->number;
    session->said = 0;
    session->alive_count = session->alive_at = 0;
    return true;
}

/* Return whether a number is of an ALIVE that is too old, or before one. */
static bool too_late(const st_session *session, uint32_t heard, uint64_t began_us)
{
    for (uint8_t index = 0; index < session->alive_count; index++) {
        if (session->alive_us[index] + ST_LATE_US < began_us
            && heard <= session->alive_number[index]) {
            return true;
        }
    }
    return false;
}

/* Return why a packet is not taken, or 0; changes nothing. */
uint8_t st_judge(const st_board *board, const st_message *message, uint64_t began_us)
{
    const st_session *session = &board->session;
    if (message->version != ST_VERSION || session->number == 0u
        || message->session != session->number) {
        return ST_FOREIGN;
    }
    if (message->number <= session->taken) {
        return ST_OLD;
    }
    /* A stop is never too late: its sender may receive nothing, and must get through. */
    return message->kind != ST_STOP && too_late(session, message->heard, began_us) ? ST_OLD : 0u;
}

/* Take a packet's number, or count why not. */
uint8_t st_take(st_board *board, const st_message *message, uint64_t began_us)
{
    const uint8_t reason = st_judge(board, message, began_us);
    if (reason == ST_OLD) {
        board->books.old_packets++;
    } else if (reason != 0u) {
        board->books.foreign_packets++;
    } else {
        board->session.taken = message->number;
    }
    return reason;
}

/* Note when an ALIVE was sent. */
void st_note_alive(st_board *board, uint64_t now_us)
{
    st_session *session = &board->session;
    session->alive_us[session->alive_at] = now_us;
    session->alive_number[session->alive_at] = session->said;
    session->alive_at = (uint8_t)((session->alive_at + 1u) % ST_ALIVES);
    if (session->alive_count < ST_ALIVES) {
        session->alive_count++;
    }
}
