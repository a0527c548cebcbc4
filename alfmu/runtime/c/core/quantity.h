/* A number with its unit, as a person reads it. */

#pragma once

#define QUANTITY 64 /* characters */

/* Write a value with its unit, an angle also in degrees; return `text`. */
const char *quantity_in_unit(const char *unit, double value, char *text);
