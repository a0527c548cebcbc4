#include "check_sum.h"

#include <stddef.h>
#include <stdint.h>

/* A check sum goes on: CRC-32 as in zip archives, four bytes at a time. */
uint32_t check_sum(uint32_t sum, const unsigned char *at, size_t count)
{
    uint32_t table[4][256];
    for (uint32_t k = 0; k < 256; k++) {
        table[0][k] = k;
        for (int bit = 0; bit < 8; bit++)
            table[0][k] = table[0][k] >> 1 ^ (table[0][k] & 1 ? 0xedb88320u : 0);
    }
    for (int j = 1; j < 4; j++)
        for (int k = 0; k < 256; k++)
            table[j][k] = table[j - 1][k] >> 8 ^ table[0][table[j - 1][k] & 255];
    for (; count >= 4; count -= 4, at += 4) {
        sum ^= at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
        sum = table[3][sum & 255] ^ table[2][sum >> 8 & 255] ^ table[1][sum >> 16 & 255] ^ table[0][sum >> 24];
    }
    for (; count; count--, at++)
        sum = table[0][(sum ^ *at) & 255] ^ sum >> 8;
    return sum;
}
