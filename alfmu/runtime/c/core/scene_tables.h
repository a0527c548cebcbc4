/* Reads the tables of a scene file: variables, switches, patterns of matrices, orders of unknowns. */

#pragma once

#include "linear.h"
#include "scene.h"
#include "scene_reader.h"

/* Nonzeros of a matrix as a graph whose nodes and edges are its rows and columns. */
typedef struct {
    const Pattern *pattern;
    int shift; /* added to its rows */
} Part;

void tables_read_numbers(Reader *r);
void tables_read_variables(Reader *r);
void tables_read_choices(Reader *r);
void tables_read_switches(Reader *r);
void tables_read_frictions(Reader *r);
void tables_read_names(Reader *r);
void tables_read_followed(Reader *r);
void tables_read_jacobian(Reader *r);
void tables_read_pattern(Reader *r, Pattern *made, int rows, int columns);
void tables_order_envelope(
    Reader *r, Envelope *made, int count, int edge_count, int by_rows, const Part *parts, int part_count);
void tables_read_leaps(Reader *r);
