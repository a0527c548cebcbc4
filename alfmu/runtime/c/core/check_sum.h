/* Check sums of scene files and states. */

#ifndef ALFMU_CHECK_SUM_H
#define ALFMU_CHECK_SUM_H

#include <stddef.h>
#include <stdint.h>

#include "internal_begin.h"

/* CRC-32 of bytes that follow others; it begins with CHECK_BEGIN, and its complement is the check sum. */
#define CHECK_BEGIN 0xffffffffu

uint32_t check_sum(uint32_t sum, const unsigned char *at, size_t count);

#include "internal_end.h"

#endif
