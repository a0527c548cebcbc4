/* Sums of products: every way to run a function adds in this order. */

#pragma once

#define SUM1(a, b, c) (a) + (b) * (c)
#define SUM2(a, b, c, d, e) (a) + (b) * (c) + (d) * (e)
#define SUM4(a, b, c, d, e, f, g, h, i) (a) + (b) * (c) + (d) * (e) + (f) * (g) + (h) * (i)
#define PRODUCTS(a, b, c, d) (a) * (b) + (c) * (d)
