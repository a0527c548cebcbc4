/* What operations of a scene compute; generated from alfmu/kernel/scene.py. */

#define BINARY_OPERATIONS(X) \
    X(2, a / b) \
    X(4, a < b) \
    X(5, a <= b) \
    X(6, a == b) \
    X(7, a != b) \
    X(8, a && b) \
    X(9, a || b) \
    X(10, a ? b : 0.0) \
    X(11, pow(a, b)) \
    X(12, pow(a, b)) \
    X(13, atan2(a, b)) \
    X(14, fmin(a, b)) \
    X(15, fmax(a, b)) \
    X(16, fmod(a, b)) \
    X(17, remainder(a, b)) \
    X(18, hypot(a, b)) \
    X(19, copysign(a, b))

#define UNARY_OPERATIONS(X) \
    X(20, !a) \
    X(21, a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : a) \
    X(22, fabs(a)) \
    X(23, floor(a)) \
    X(24, ceil(a)) \
    X(25, sqrt(a)) \
    X(26, exp(a)) \
    X(27, log(a)) \
    X(28, expm1(a)) \
    X(29, log1p(a)) \
    X(30, erf(a)) \
    X(31, sin(a)) \
    X(32, cos(a)) \
    X(33, tan(a)) \
    X(34, asin(a)) \
    X(35, acos(a)) \
    X(36, atan(a)) \
    X(37, sinh(a)) \
    X(38, cosh(a)) \
    X(39, tanh(a)) \
    X(40, asinh(a)) \
    X(41, acosh(a)) \
    X(42, atanh(a))

#define SUM1_KIND 0
#define SUM2_KIND 1
#define SINE_COSINE_KIND 3
#define KIND_COUNT 43
#define LOOP_KIND 43
#define EACH_KIND 44
#define GATHER_KIND 45
#define OPERAND_COUNTS 3, 5, 2, 1, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1
#define VALUES_OF(kind) ((kind) == SINE_COSINE_KIND ? 2 : 1)
enum { CALL_CODE, CHOICE_CODE, LOOP_CODE, FACTOR_CODE, SOLVE_CODE, LEAST_NORM_CODE };
