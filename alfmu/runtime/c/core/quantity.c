#include "quantity.h"

#include "layout.h"
#include "text.h"

const char *quantity_in_unit(const char *unit, double value, char *text)
{
    if (!strcmp(unit, "rad"))
        write_text(text, QUANTITY, "%.6g rad (%.4g deg)", value, value * 90 / QUARTER);
    else
        write_text(text, QUANTITY, strcmp(unit, "1") ? "%.6g %s" : "%.6g", value, unit);
    return text;
}
