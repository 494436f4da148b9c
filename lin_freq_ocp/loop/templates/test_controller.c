/* Run {{ steps }} recorded steps and compare their controls with those that lin_freq_ocp computed in double.

     ./test_controller           print the largest difference, sizes and counts; the exit status is 0 if all is well
     ./test_controller log.csv   write a log of the steps, too, for lfo.certify_log */
#include "controller.h"
#include <math.h>
#include <stdio.h>
#include <string.h>

#define STEPS {{ steps }}
#define N CONTROLLER_MEASURED
#define M CONTROLLER_CONTROLS

{% for name, kind, values in recorded %}
static const {{ kind }} {{ name }}[] = {
{% for line in values %}
  {{ line }}
{% endfor %}
};
{% endfor %}

static void print_log(FILE *log, const lfo_real *values, int count) {
  for (int i = 0; i < count; i++) fprintf(log, "%.{{ real.digits }}g,", (double)values[i]);
}

int main(int argc, char **argv) {
  static controller c, before;
  FILE *log = argc > 1 ? fopen(argv[1], "w") : NULL;
  lfo_real x[N], u[M];
  double worst = 0;
  int changes = 0, sweeps = 0, planned = 0, failed = 0{{ ", others = 0" if windows }};
  if (argc > 1 && !log) {
    fprintf(stderr, "%s: cannot be written\n", argv[1]);
    return 2;
  }
  if (log) fputs("{{ header }}\n", log);
  controller_begin(&c);
  for (int k = 0; k < STEPS; k++) {
    int status;
    status = controller_step(&c, states + k * N, {{ "references + k * N, " if references }}u);
    double apart = 0;
    for (int j = 0; j < M; j++) {
      double difference = fabs((double)u[j] - (double)controls[k * M + j]) / (double)sizes[j];
      if (!(difference <= apart)) apart = difference;
    }
    if (status >= CONTROLLER_CAPPED) memcpy(u, controls + k * M, sizeof u); /* acts in its place */
{% if windows or delay and not known %}
    controller_applied(&c, controls + k * M); /* so that rounding does not add up */
{% else %}
    controller_applied(&c, u);
{% endif %}
    if (log) {
      print_log(log, states + k * N, N);
{% if references %}
      print_log(log, references + k * N, N);
{% endif %}
      print_log(log, u, M);
      fprintf(log, "%d\n", status);
    }
{% if windows %}
    others |= status >= CONTROLLER_CAPPED; /* windows of later steps hold other samples than those of its own plan */
    if (others) continue;
{% endif %}
    if (status > CONTROLLER_CAPPED) failed++; /* all recorded states have a plan */
    if (status >= CONTROLLER_CAPPED) continue;
    planned++;
    if (c.memory.changes > changes) changes = c.memory.changes;
    if (c.memory.sweeps > sweeps) sweeps = c.memory.sweeps;
    if (!(apart <= worst)) worst = apart;
  }
  if (log) fclose(log);
  memcpy(&before, &c, sizeof c);
  for (int i = 0; i < N; i++) x[i] = states[i];
  x[0] = (lfo_real)NAN;
  if (controller_step(&c, x, {{ "references, " if references }}u) != CONTROLLER_NO_STATE) failed++;
{% if not windows %}
  if (memcmp(before.reals, c.reals, sizeof c.reals) != 0) failed++;
{% endif %}
  printf("%d of %d steps planned, largest difference %.1e of the largest control (allowed: %.0e), %d failed\n", planned,
         STEPS, worst, {{ real.allowed }}, failed);
  printf("memory %lu bytes, tables %d bytes, at most %d changes and %d sweeps a step\n", (unsigned long)sizeof c,
         CONTROLLER_TABLE_BYTES, changes, sweeps);
  printf("a sweep has %d multiply-adds, a change at most %d\n", {{ summary.sweep_work }}, {{ summary.change_work }});
  return failed > 0 || {{ "planned == 0 || " if not capped }}!(worst <= {{ real.allowed }});
}
