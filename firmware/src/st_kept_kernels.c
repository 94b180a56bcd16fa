/* Kernels that are kept from session to session, and their sums. */
#include <string.h>

#include "st_inside.h"

/* Forget the table of kernels. */
static void forget(st_keep *keep)
{
    (void)memset(keep, 0, sizeof *keep);
}

/* Read one kernel at a place; return what follows it, 0 if it is none. */
static uint32_t read_kernel(const st_board *board, uint32_t at)
{
    const uint8_t *data = board->config.kernels;
    const uint32_t size = board->keep.size;
    const uint32_t electrodes = board->config.electrodes;
    if (size - at < 4u || st_u16(data + at) >= electrodes) {
        return 0;
    }
    uint32_t runs = st_u16(data + at + 2);
    uint32_t end = 0;
    int32_t net = 0;
    at += 4u;
    for (; runs > 0u; runs--) {
        if (size - at < 4u) {
            return 0;
        }
        const uint32_t first = st_u16(data + at);
        const uint32_t count = st_u16(data + at + 2);
        at += 4u;
        if (first < end || count == 0u || first + count > electrodes || (size - at) / 2u < count) {
            return 0;
        }
        end = first + count;
        for (uint32_t index = 0; index < count; index++) {
            const int16_t weight = st_i16(data + at);
            if (weight == INT16_MIN) {
                return 0;
            }
            net += weight;
            at += 2u;
        }
    }
    return net == 0 ? at : 0u;
}

/* Check the whole table, and note where each kernel begins. */
static bool read_all(st_board *board)
{
    const st_keep *keep = &board->keep;
    const uint8_t *data = board->config.kernels;
    if (keep->size < 4u || st_u16(data) != board->config.electrodes) {
        return false;
    }
    const uint32_t count = st_u16(data + 2);
    if (count > board->config.most_kernels) {
        return false;
    }
    uint32_t at = 4;
    for (uint32_t index = 0; index < count; index++) {
        board->config.kernel_at[index] = at;
        at = read_kernel(board, at);
        if (at == 0u) {
            return false;
        }
    }
    board->keep.count = count;
    return at == keep->size;
}

/* Take a piece of a table of kernels; check it when the last byte has come. */
void st_keep_take(st_board *board, const uint8_t *payload, uint32_t size)
{
    st_keep *keep = &board->keep;
    const uint32_t whole = st_u32(payload + ST_IDENTITY_BYTES);
    const uint32_t offset = st_u32(payload + ST_IDENTITY_BYTES + 4u);
    const uint32_t count = size - ST_LOAD_HEAD;
    if (memcmp(payload, keep->identity, ST_IDENTITY_BYTES) != 0 || whole != keep->size) {
        forget(keep);
        if (whole > board->config.kernel_bytes) {
            return;
        }
        (void)memcpy(keep->identity, payload, ST_IDENTITY_BYTES);
        keep->size = whole;
        st_sha256_begin(&keep->hash);
    }
    if (keep->whole || offset != keep->received || count > keep->size - keep->received) {
        return;
    }
    if (count > 0u) {
        (void)memcpy(board->config.kernels + offset, payload + ST_LOAD_HEAD, count);
        st_sha256_add(&keep->hash, payload + ST_LOAD_HEAD, count);
    }
    keep->received += count;
    if (keep->received == keep->size) {
        uint8_t identity[ST_IDENTITY_BYTES];
        st_sha256_end(&keep->hash, identity);
        if (memcmp(identity, keep->identity, sizeof identity) == 0 && read_all(board)) {
            keep->whole = true;
        } else {
            forget(keep);
        }
    }
}

/* Hash session and table once in a session: takes as long as SHA-256 of the table does. */
void st_keep_prove(st_board *board)
{
    st_keep *keep = &board->keep;
    uint8_t session[8];
    if (!keep->whole || keep->proved) {
        return;
    }
    (void)st_put_u32(st_put_u32(session, (uint32_t)board->session.number),
                     (uint32_t)(board->session.number >> 32));
    st_sha256_begin(&keep->hash);
    st_sha256_add(&keep->hash, session, sizeof session);
    st_sha256_add(&keep->hash, board->config.kernels, keep->size);
    st_sha256_end(&keep->hash, keep->proof);
    keep->proved = true;
}

/* Add a kernel by an amplitude to the board's sums. */
void st_add_kernel(const st_board *board, uint32_t kernel, uint32_t amplitude)
{
    const uint8_t *at = board->config.kernels + board->config.kernel_at[kernel];
    uint32_t runs = st_u16(at + 2);
    at += 4;
    for (; runs > 0u; runs--) {
        int32_t *sum = board->config.sums + st_u16(at);
        uint32_t count = st_u16(at + 2);
        at += 4;
        for (; count > 0u; count--) {
            /* Amplitudes of a slot add up to 65,535 at most: no sum passes 2^31. */
            *sum += (int32_t)st_i16(at) * (int32_t)amplitude;
            sum++;
            at += 2;
        }
    }
}

/* Return the site of a kernel. */
uint16_t st_kernel_site(const st_board *board, uint32_t kernel)
{
    return st_u16(board->config.kernels + board->config.kernel_at[kernel]);
}
