/* SHA-256 (FIPS 180-4): the identity of a table of kernels, and the proof that it is here. */
#include <string.h>

#include "st_inside.h"

/* Rotate a word to the right. */
static uint32_t rotated(uint32_t word, unsigned by)
{
    return (word >> by) | (word << (32u - by));
}

/* Take one block of 64 bytes into the state. */
static void take_block(st_sha256 *hash)
{
    static const uint32_t constant[64] = {
        0x428A2F98u, 0x71374491u, 0xB5C0FBCFu, 0xE9B5DBA5u, 0x3956C25Bu, 0x59F111F1u, 0x923F82A4u,
        0xAB1C5ED5u, 0xD807AA98u, 0x12835B01u, 0x243185BEu, 0x550C7DC3u, 0x72BE5D74u, 0x80DEB1FEu,
        0x9BDC06A7u, 0xC19BF174u, 0xE49B69C1u, 0xEFBE4786u, 0x0FC19DC6u, 0x240CA1CCu, 0x2DE92C6Fu,
        0x4A7484AAu, 0x5CB0A9DCu, 0x76F988DAu, 0x983E5152u, 0xA831C66Du, 0xB00327C8u, 0xBF597FC7u,
        0xC6E00BF3u, 0xD5A79147u, 0x06CA6351u, 0x14292967u, 0x27B70A85u, 0x2E1B2138u, 0x4D2C6DFCu,
        0x53380D13u, 0x650A7354u, 0x766A0ABBu, 0x81C2C92Eu, 0x92722C85u, 0xA2BFE8A1u, 0xA81A664Bu,
        0xC24B8B70u, 0xC76C51A3u, 0xD192E819u, 0xD6990624u, 0xF40E3585u, 0x106AA070u, 0x19A4C116u,
        0x1E376C08u, 0x2748774Cu, 0x34B0BCB5u, 0x391C0CB3u, 0x4ED8AA4Au, 0x5B9CCA4Fu, 0x682E6FF3u,
        0x748F82EEu, 0x78A5636Fu, 0x84C87814u, 0x8CC70208u, 0x90BEFFFAu, 0xA4506CEBu, 0xBEF9A3F7u,
        0xC67178F2u
    };
    uint32_t schedule[16]; /* the last 16 words of the message schedule */
    uint32_t v[8];         /* the working variables a to h */
    (void)memcpy(v, hash->state, sizeof v);
    for (unsigned round = 0; round < 64u; round++) {
        uint32_t *word = &schedule[round % 16u];
        if (round < 16u) {
            const uint8_t *at = hash->block + 4u * round;
            *word = ((uint32_t)at[0] << 24) | ((uint32_t)at[1] << 16) | ((uint32_t)at[2] << 8)
                    | at[3];
        } else {
            const uint32_t two = schedule[(round - 2u) % 16u];
            const uint32_t fifteen = schedule[(round - 15u) % 16u];
            *word += (rotated(two, 17) ^ rotated(two, 19) ^ (two >> 10))
                     + schedule[(round - 7u) % 16u]
                     + (rotated(fifteen, 7) ^ rotated(fifteen, 18) ^ (fifteen >> 3));
        }
        const uint32_t chosen = (v[4] & v[5]) ^ (~v[4] & v[6]);
        const uint32_t majority = (v[0] & v[1]) ^ (v[0] & v[2]) ^ (v[1] & v[2]);
        const uint32_t one = v[7] + (rotated(v[4], 6) ^ rotated(v[4], 11) ^ rotated(v[4], 25))
                             + chosen + constant[round] + *word;
        const uint32_t two = (rotated(v[0], 2) ^ rotated(v[0], 13) ^ rotated(v[0], 22)) + majority;
        (void)memmove(v + 1, v, 7u * sizeof *v);
        v[4] += one;
        v[0] = one + two;
    }
    for (unsigned index = 0; index < 8u; index++) {
        hash->state[index] += v[index];
    }
}

/* Begin a hash. */
void st_sha256_begin(st_sha256 *hash)
{
    static const uint32_t first[8] = { 0x6A09E667u, 0xBB67AE85u, 0x3C6EF372u, 0xA54FF53Au,
                                       0x510E527Fu, 0x9B05688Cu, 0x1F83D9ABu, 0x5BE0CD19u };
    (void)memcpy(hash->state, first, sizeof first);
    hash->size = 0;
}

/* Add bytes to a hash. */
void st_sha256_add(st_sha256 *hash, const uint8_t *data, size_t size)
{
    while (size > 0u) {
        const size_t filled = (size_t)(hash->size % sizeof hash->block);
        const size_t left = sizeof hash->block - filled;
        const size_t count = size < left ? size : left;
        (void)memcpy(hash->block + filled, data, count);
        hash->size += count;
        data += count;
        size -= count;
        if (count == left) {
            take_block(hash);
        }
    }
}

/* End a hash, and write its first 16 bytes. */
void st_sha256_end(st_sha256 *hash, uint8_t digest[ST_IDENTITY_BYTES])
{
    static const uint8_t padding[64] = { 0x80 };
    const uint64_t bits = 8u * hash->size;
    const size_t filled = (size_t)(hash->size % sizeof hash->block);
    uint8_t length[8];
    for (unsigned index = 0; index < 8u; index++) {
        length[index] = (uint8_t)(bits >> (56u - 8u * index));
    }
    st_sha256_add(hash, padding, (filled < 56u ? 56u : 120u) - filled);
    st_sha256_add(hash, length, sizeof length);
    for (unsigned index = 0; index < ST_IDENTITY_BYTES; index++) {
        digest[index] = (uint8_t)(hash->state[index / 4u] >> (24u - 8u * (index % 4u)));
    }
}
