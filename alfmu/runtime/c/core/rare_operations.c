#include "rare_operations.h"

#include "baseline.h"
#include "operations.h"

#define VALUE(kind, value) \
    case kind: \
        return value;

double operation_value(int kind, double a, double b)
{
    switch (kind) {
        BINARY_OPERATIONS(VALUE)
        UNARY_OPERATIONS(VALUE)
    }
    return NAN;
}

#define BY_BOTH(kind, by_a, by_b) \
    case kind: \
        of[0] = by_a; \
        of[1] = by_b; \
        break;
#define BY_ONE(kind, by_a) \
    case kind: \
        of[0] = by_a; \
        break;

void operation_partials(int kind, double a, double b, double of[2])
{
    of[0] = of[1] = 0.0;
    switch (kind) {
        BINARY_PARTIALS(BY_BOTH)
        UNARY_PARTIALS(BY_ONE)
    }
}
