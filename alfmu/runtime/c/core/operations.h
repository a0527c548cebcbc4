/* Operations of a scene and their formulas; generated from alfmu/kernel/scene.py. */

#ifndef ALFMU_OPERATIONS_H
#define ALFMU_OPERATIONS_H

#define BINARY_OPERATIONS(X) \
    X(10, a < b) \
    X(11, a <= b) \
    X(12, a == b) \
    X(13, a != b) \
    X(14, a && b) \
    X(15, a || b) \
    X(16, a ? b : 0.0) \
    X(17, pow(a, b)) \
    X(18, pow(a, b)) \
    X(19, atan2(a, b)) \
    X(20, a < b || b != b ? a : b) \
    X(21, a > b || b != b ? a : b) \
    X(22, fmod(a, b)) \
    X(23, remainder(a, b)) \
    X(24, hypot(a, b)) \
    X(25, copysign(a, b))

#define UNARY_OPERATIONS(X) \
    X(26, !a) \
    X(27, a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : a) \
    X(28, fabs(a)) \
    X(29, floor(a)) \
    X(30, ceil(a)) \
    X(31, sqrt(a)) \
    X(32, exp(a)) \
    X(33, log(a)) \
    X(34, expm1(a)) \
    X(35, log1p(a)) \
    X(36, erf(a)) \
    X(37, sin(a)) \
    X(38, cos(a)) \
    X(39, tan(a)) \
    X(40, asin(a)) \
    X(41, acos(a)) \
    X(42, atan(a)) \
    X(43, sinh(a)) \
    X(44, cosh(a)) \
    X(45, tanh(a)) \
    X(46, asinh(a)) \
    X(47, acosh(a)) \
    X(48, atanh(a))

#define SHORT_OPERATIONS(X) \
    X(10, a < b) \
    X(11, a <= b) \
    X(12, a == b) \
    X(13, a != b) \
    X(14, a && b) \
    X(15, a || b) \
    X(26, !a) \
    X(16, a ? b : 0.0) \
    X(20, a < b || b != b ? a : b) \
    X(21, a > b || b != b ? a : b) \
    X(28, fabs(a)) \
    X(31, sqrt(a))

#define BINARY_PARTIALS(X) \
    X(10, 0.0, 0.0) \
    X(11, 0.0, 0.0) \
    X(12, 0.0, 0.0) \
    X(13, 0.0, 0.0) \
    X(14, 0.0, 0.0) \
    X(15, 0.0, 0.0) \
    X(16, 0.0, (a ? 1.0 : 0.0)) \
    X(17, (b * (pow(a, (b - 1.0)))), ((log(a)) * (pow(a, b)))) \
    X(18, (b * (pow(a, (b - 1.0)))), ((log(a)) * (pow(a, b)))) \
    X(19, (b / ((a * a) + (b * b))), (-(a / ((a * a) + (b * b))))) \
    X(20, (((double)(a <= b)) / (((double)(a <= b)) + ((double)(b <= a)))), (((double)(b <= a)) / (((double)(a <= b)) + ((double)(b <= a))))) \
    X(21, (((double)(b <= a)) / (((double)(b <= a)) + ((double)(a <= b)))), (((double)(a <= b)) / (((double)(b <= a)) + ((double)(a <= b))))) \
    X(22, 1.0, (((fmod(a, b)) - a) / b)) \
    X(23, 1.0, (((remainder(a, b)) - a) / b)) \
    X(24, (a / (hypot(a, b))), (b / (hypot(a, b)))) \
    X(25, ((copysign(1.0, b)) * (a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : a)), 0.0)

#define UNARY_PARTIALS(X) \
    X(26, 0.0) \
    X(27, 0.0) \
    X(28, (a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : a)) \
    X(29, 0.0) \
    X(30, 0.0) \
    X(31, (1.0 / (2.0 * (sqrt(a))))) \
    X(32, (exp(a))) \
    X(33, (1.0 / a)) \
    X(34, (exp(a))) \
    X(35, (1.0 / (1.0 + a))) \
    X(36, (1.1283791670955126 * (exp((-(a * a)))))) \
    X(37, (cos(a))) \
    X(38, (-(sin(a)))) \
    X(39, (1.0 / ((cos(a)) * (cos(a))))) \
    X(40, (1.0 / (sqrt((1.0 - (a * a)))))) \
    X(41, ((-1.0) / (sqrt((1.0 - (a * a)))))) \
    X(42, (1.0 / (1.0 + (a * a)))) \
    X(43, (cosh(a))) \
    X(44, (sinh(a))) \
    X(45, (1.0 - ((tanh(a)) * (tanh(a))))) \
    X(46, (1.0 / (sqrt((1.0 + (a * a)))))) \
    X(47, ((1.0 / (sqrt((a - 1.0)))) / (sqrt((a + 1.0))))) \
    X(48, (1.0 / (1.0 - (a * a))))

#define SUM1_KIND 0
#define SUM2_KIND 1
#define SUM4_KIND 2
#define PRODUCT_KIND 3
#define PRODUCTS_KIND 4
#define PLUS_KIND 5
#define MINUS_KIND 6
#define NEGATIVE_KIND 7
#define IS_BINARY(kind) ((kind) <= 25) /* of those above */
#define OVER_KIND 8
#define SINE_COSINE_KIND 9
#define KIND_COUNT 49
#define LOOP_KIND 49
#define EACH_KIND 50
#define GATHER_KIND 51
#define NARROW_HEAD 3 /* words before the operands of a run with 16-bit places, once loaded */
#define OPERAND_COUNTS 3, 5, 9, 2, 4, 2, 2, 1, 2, 1, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1
#define VALUES_OF(kind) ((kind) == SINE_COSINE_KIND ? 2 : 1)
#define OPERATIONS 256
enum { UNARY_ROLE, BINARY_ROLE, INPUT_ROLE, OUTPUT_ROLE, CONSTANT_ROLE, DOUBLED_ROLE, INVERSE_ROLE, COSINE_ROLE, COPYSIGN_ROLE };
enum { CALL_CODE, CHOICE_CODE, LOOP_CODE, FACTOR_CODE, SOLVE_CODE, LEAST_NORM_CODE, LANES_CODE, AGAIN_CODE };

#endif
