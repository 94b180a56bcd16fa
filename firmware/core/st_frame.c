/* Packets on a byte stream: COBS between zeros, and a CRC. */
#include <string.h>

#include "st_inside.h"

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

static void put_u32(uint8_t *at, uint32_t value)
{
    for (unsigned byte = 0; byte < 4u; byte++) {
        at[byte] = (uint8_t)(value >> (8u * byte));
    }
}

void st_say(st_board *board, uint8_t kind, uint64_t session, uint32_t number, uint32_t heard,
            uint32_t about, const uint8_t *payload, size_t size)
{
    uint8_t body[ST_OUT_BYTES];
    uint8_t coded[ST_OUT_BYTES + 4u];
    size_t end = ST_HEAD_BYTES + size;
    if (end + 4u > sizeof body) {
        return;
    }
    body[0] = ST_VERSION;
    body[1] = kind;
    put_u32(body + 2, number);
    put_u32(body + 6, (uint32_t)session);
    put_u32(body + 10, (uint32_t)(session >> 32));
    put_u32(body + 14, heard);
    put_u32(body + 18, about);
    if (size > 0u) {
        memcpy(body + ST_HEAD_BYTES, payload, size);
    }
    put_u32(body + end, st_crc32(0, body, end));
    end += 4u;
    size_t code_at = 0;
    size_t out = 1;
    /* Shorter than 254 bytes: no block is full. */
    for (size_t at = 0; at < end; at++) {
        if (body[at] == 0u) {
            coded[code_at] = (uint8_t)(out - code_at);
            code_at = out;
            out++;
        } else {
            coded[out] = body[at];
            out++;
        }
    }
    coded[code_at] = (uint8_t)(out - code_at);
    coded[out] = 0;
    board->port.send(board->port.self, coded, out + 1u);
}

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

void st_parse(const uint8_t *body, uint32_t size, st_message *message)
{
    memset(message, 0, sizeof *message);
    message->version = body[0];
    message->kind = body[1];
    message->number = st_u32(body + 2);
    /* Of any other version no more is known; version 3 has the same head. */
    if ((message->version == ST_VERSION || message->version == 3u) && size >= ST_HEAD_BYTES) {
        message->session = st_u32(body + 6) | ((uint64_t)st_u32(body + 10) << 32);
        message->heard = st_u32(body + 14);
        message->about = st_u32(body + 18);
        message->payload = body + ST_HEAD_BYTES;
        message->size = size - ST_HEAD_BYTES;
    }
}

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
