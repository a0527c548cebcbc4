/* Moves a batch of the scene of a file, and prints a variable of each member: for the sanitizers of tests/test_batch.py. */

#include <stdio.h>
#include <stdlib.h>

#include "instance.h"
#include "scene.h"

#define COUNT 40

typedef struct Batch Batch;
Scene *alfmu_scene_load(const unsigned char *bytes, size_t size, char *why, size_t why_size);
void alfmu_scene_free(Scene *s);
Batch *alfmu_batch_new(const Scene *s, size_t count);
void alfmu_batch_free(Batch *b);
void alfmu_batch_set(Batch *b, const int *references, int count, const double *values, const unsigned char *chosen,
    int *outcomes);
void alfmu_batch_get(
    Batch *b, const int *references, int count, double *values, const unsigned char *chosen, int *outcomes);
void alfmu_batch_initialize(Batch *b, const unsigned char *chosen, int *outcomes);
void alfmu_batch_step(Batch *b, double h, const unsigned char *chosen, int *outcomes);

/* Arguments: the file, the references of what is set and of what is printed, the first value that is set. */
int main(int argc, char **argv)
{
    static unsigned char bytes[1 << 24];
    FILE *file = argc == 5 ? fopen(argv[1], "rb") : NULL;
    const size_t size = file ? fread(bytes, 1, sizeof bytes, file) : 0;
    const int set = argc == 5 ? atoi(argv[2]) : 0, get = argc == 5 ? atoi(argv[3]) : 0;
    char why[500] = "";
    Scene *s = alfmu_scene_load(bytes, size, why, sizeof why);
    Batch *b = s ? alfmu_batch_new(s, COUNT) : NULL;
    double values[COUNT];
    int outcomes[COUNT] = {0};
    if (!b)
        return fprintf(stderr, "no batch: %s\n", why), 2;
    fclose(file);
    for (int k = 0; k < COUNT; k++)
        values[k] = atof(argv[4]) + 0.005 * k;
    alfmu_batch_set(b, &set, 1, values, NULL, outcomes);
    alfmu_batch_initialize(b, NULL, outcomes);
    for (int k = 0; k < 20; k++)
        alfmu_batch_step(b, 0.05, NULL, outcomes);
    alfmu_batch_get(b, &get, 1, values, NULL, outcomes);
    for (int k = 0; k < COUNT; k++)
        printf("%d %.17g\n", outcomes[k], values[k]);
    alfmu_batch_free(b);
    alfmu_scene_free(s);
    return 0;
}
