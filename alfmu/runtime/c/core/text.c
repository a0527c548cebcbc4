#include "text.h"

#include <stdarg.h>

typedef struct {
    char *to;
    size_t left;
} Written;

static void put(Written *w, char c)
{
    if (w->left > 1) {
        *w->to++ = c;
        w->left--;
    }
}

static void put_text(Written *w, const char *text, int most)
{
    for (; *text && most; most--)
        put(w, *text++);
}

/* Write an integer with at least `least` digits. */
static void put_whole(Written *w, long value, int least)
{
    char digits[24];
    int count = 0;
    unsigned long size = value < 0 ? 0ul - (unsigned long)value : (unsigned long)value;
    if (value < 0)
        put(w, '-');
    for (; size || count < least; size /= 10)
        digits[count++] = (char)('0' + size % 10);
    while (count)
        put(w, digits[--count]);
}

/* Write a number with `count` significant digits, at most 9, as %g or %e does. */
static void put_number(Written *w, double value, int count, int scientific)
{
    int tens = count - 1, point;
    long digits, unit = 1;
    if (value < 0.0)
        put(w, '-');
    value = fabs(value);
    if (!(value <= DBL_MAX)) {
        put_text(w, value > 0.0 ? "inf" : "nan", -1);
        return;
    }
    for (int k = 1; k < count; k++)
        unit *= 10;
    for (; value >= 10.0 * (double)unit; tens++)
        value /= 10.0;
    for (; value > 0.0 && value < (double)unit; tens--)
        value *= 10.0;
    tens = value > 0.0 ? tens : 0;
    digits = (long)(value + 0.5);
    if (digits == 10 * unit) {
        digits = unit;
        tens++;
    }
    scientific |= 2 * (tens < -4 || tens >= count);
    point = scientific ? 0 : tens;
    for (int k = point; k < 0; k++)
        put_text(w, k == point ? "0." : "0", -1);
    for (int k = 0; k < count && (digits || k <= point || scientific & 1); k++, unit /= 10) {
        if (k == point + 1 && k)
            put(w, '.');
        put(w, (char)('0' + digits / unit));
        digits %= unit;
    }
    if (scientific) {
        put_text(w, tens < 0 ? "e-" : "e+", -1);
        put_whole(w, tens < 0 ? -tens : tens, 2);
    }
}

void write_list(char *text, size_t size, const char *format, va_list arguments)
{
    Written w = {text, size};
    for (; *format; format++) {
        int digits = -1;
        if (*format != '%') {
            put(&w, *format);
            continue;
        }
        if (*++format == '.')
            for (digits = 0, format++; *format >= '0' && *format <= '9'; format++)
                digits = 10 * digits + (*format - '0');
        if (*format == 's')
            put_text(&w, va_arg(arguments, const char *), digits);
        else if (*format == 'd')
            put_whole(&w, va_arg(arguments, int), 1);
        else
            put_number(&w, va_arg(arguments, double), *format == 'e' ? digits + 1 : digits < 0 ? 6 : digits,
                *format == 'e');
    }
    if (size)
        *w.to = '\0';
}

void write_text(char *text, size_t size, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    write_list(text, size, format, arguments);
    va_end(arguments);
}
