/* Packets on a byte stream: COBS between zeros, and a CRC. */
#include <string.h>

#include "st_inside.h"

#define BLOCK 256u /* a block of COBS, and the zero at the end of a packet */

/* Return the CRC-32 of IEEE 802.3 of data, continued from that of what is before. */
uint32_t st_crc32(uint32_t crc, const uint8_t *data, size_t size)
{
    static const uint32_t nibble[16] = {
        0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u,
        0x4DB26158u, 0x5005713Cu, 0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu,
        0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu
    };
    crc = ~crc;
    for (size_t index = 0; index < size; index++) {
        crc = nibble[(crc ^ data[index]) & 15u] ^ (crc >> 4);
        crc = nibble[(crc ^ (uint32_t)(data[index] >> 4)) & 15u] ^ (crc >> 4);
    }
    return ~crc;
}

/* A packet on its way out: most go at once, the others by pieces. */
typedef struct {
    const st_port *port;
    uint8_t coded[2u * BLOCK];
    size_t code_at, out; /* of the block at hand, and its end */
    bool owed;           /* a block, even if nothing more comes */
} writer;

/* End a COBS block, and send what is full. */
static void end_block(writer *to, bool owed)
{
    to->coded[to->code_at] = (uint8_t)(to->out - to->code_at);
    if (to->out > BLOCK) {
        to->port->send(to->port->self, to->coded, to->out);
        to->out = 0;
    }
    to->code_at = to->out;
    to->out++;
    to->owed = owed;
}

/* Encode bytes by COBS. */
static void encode(writer *to, const uint8_t *data, size_t size)
{
    for (size_t at = 0; at < size; at++) {
        if (data[at] == 0u) {
            end_block(to, true);
        } else {
            to->coded[to->out] = data[at];
            to->out++;
            if (to->out - to->code_at == 0xFFu) {
                end_block(to, false);
            }
        }
    }
}

/* Send one packet; takes 600 bytes of stack. */
void st_send_packet(st_board *board, uint8_t kind, uint64_t session, uint32_t number,
                    uint32_t heard, uint32_t about, const uint8_t *payload, size_t size)
{
    writer to = { &board->port, { 0 }, 0, 1, true };
    uint8_t head[ST_HEAD_BYTES] = { ST_VERSION, kind };
    uint8_t crc[4];
    (void)st_put_u32(head + 2, number);
    head[6] = board->open ? 1u : 0u;
    (void)st_put_u32(head + 7, (uint32_t)session);
    (void)st_put_u32(head + 11, (uint32_t)(session >> 32));
    (void)st_put_u32(head + 15, heard);
    (void)st_put_u32(head + 19, about);
    (void)st_put_u32(crc, st_crc32(st_crc32(0, head, sizeof head), payload, size));
    encode(&to, head, sizeof head);
    encode(&to, payload, size);
    encode(&to, crc, sizeof crc);
    if (to.owed || to.out - to.code_at > 1u) {
        to.coded[to.code_at] = (uint8_t)(to.out - to.code_at);
    } else {
        to.out--;
    }
    to.coded[to.out] = 0;
    to.port->send(to.port->self, to.coded, to.out + 1u);
}

/* Put a decoded byte into the buffer; what has no room breaks the packet. */
static void put(st_board *board, uint8_t byte)
{
    st_stream *stream = &board->stream;
    if (stream->filled < board->config.packet_bytes) {
        board->config.buffer[stream->packet][stream->filled] = byte;
        stream->filled++;
    } else {
        stream->broken = true;
    }
}

/* Decode one byte; check the CRC at a packet's end, and count what is garbled. */
bool st_take_byte(st_board *board, uint8_t byte, uint64_t now_us, uint32_t *size)
{
    st_stream *stream = &board->stream;
    if (byte != 0u) {
        if (!stream->started) {
            stream->started = true;
            stream->packet_us = now_us;
        }
        if (stream->block_left > 0u) {
            put(board, byte);
            stream->block_left--;
        } else {
            if (stream->code != 0u && stream->code != 0xFFu) {
                put(board, 0);
            }
            stream->code = byte;
            stream->block_left = (uint32_t)byte - 1u;
        }
        return false;
    }
    const bool started = stream->started;
    const bool broken = stream->broken || stream->block_left > 0u;
    const uint32_t filled = stream->filled;
    stream->started = stream->broken = false;
    stream->filled = stream->block_left = 0;
    stream->code = 0;
    if (!started) {
        return false;
    }
    const uint8_t *body = board->config.buffer[stream->packet];
    /* Version, kind, number and CRC at least. */
    if (broken || filled < 10u || st_crc32(0, body, filled - 4u) != st_u32(body + filled - 4u)) {
        board->books.framing_errors++;
        return false;
    }
    *size = filled - 4u;
    return true;
}

/* Read the head of a decoded packet of any version. */
void st_parse(const uint8_t *body, uint32_t size, st_message *message)
{
    (void)memset(message, 0, sizeof *message);
    message->version = body[0];
    message->kind = body[1];
    message->number = st_u32(body + 2);
    /* Of any other version no more is known. */
    if (message->version == ST_VERSION && size >= ST_HEAD_BYTES) {
        message->session = st_u32(body + 7) | ((uint64_t)st_u32(body + 11) << 32);
        message->heard = st_u32(body + 15);
        message->about = st_u32(body + 19);
        message->payload = body + ST_HEAD_BYTES;
        message->size = size - ST_HEAD_BYTES;
    }
}

/* Read the head of the packet that comes in, if it is there already. */
bool st_head(st_board *board, st_message *message)
{
    const st_stream *stream = &board->stream;
    uint32_t filled = stream->filled;
    if (!stream->started || stream->broken) {
        return false;
    }
    uint8_t *body = board->config.buffer[stream->packet];
    if (stream->block_left == 0u && stream->code != 0xFFu && filled < board->config.packet_bytes) {
        /* The zero that follows a block; if more comes, it is written once more. */
        body[filled] = 0;
        filled++;
    }
    if (filled < ST_HEAD_BYTES) {
        return false;
    }
    st_parse(body, ST_HEAD_BYTES, message);
    return true;
}
