/* Time each of many steps of a generated controller. */
#define _POSIX_C_SOURCE 199309L
#include "controller.h"
#include <time.h>

void bench(int count, const lfo_real *x, lfo_real *u, int *status, double *ns, int *changes, int *active);

void bench(int count, const lfo_real *x, lfo_real *u, int *status, double *ns, int *changes, int *active) {
  static controller c;
  controller_begin(&c);
  for (int k = 0; k < count; k++) {
    struct timespec a, b;
    double took;
    clock_gettime(CLOCK_MONOTONIC, &a);
    status[k] = controller_step(&c, x + k * CONTROLLER_MEASURED, u + k * CONTROLLER_CONTROLS);
    clock_gettime(CLOCK_MONOTONIC, &b);
    took = (double)(b.tv_sec - a.tv_sec) * 1e9 + (double)(b.tv_nsec - a.tv_nsec);
    if (took < ns[k]) ns[k] = took;
    changes[k] = c.memory.changes;
    active[k] = c.memory.active;
  }
}
