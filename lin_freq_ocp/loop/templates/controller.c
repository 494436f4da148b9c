/* The tables of a controller, and its step: lfo_kernel.c in the units of the problem. */
#include "controller.h"
#include <string.h>

#define N CONTROLLER_STATES
#define M CONTROLLER_CONTROLS
#define NONE ((lfo_real)LFO_NONE)

{% for name, kind, values in tables %}
static const {{ kind }} {{ name }}[] = {
{% for line in values %}
  {{ line }}
{% endfor %}
};
{% endfor %}

/* A state is (x - origin) times a power of two, a control u times one: changing units rounds nothing. */
static const lfo_model model = {
{% for name, value in integers.items() %}
  .{{ name }} = {{ value }},
{% endfor %}
{% for name, value in numbers.items() %}
  .{{ name }} = {{ real.literal(value) }},
{% endfor %}
{% for name, _, _ in tables[:-3] %}
  .{{ name }} = {{ name }},
{% endfor %}
};

static lfo_real product(const lfo_real *a, const lfo_real *b, int count) {
  lfo_real sum = 0;
  for (int i = 0; i < count; i++) sum += a[i] * b[i];
  return sum;
}

{% if delay %}
/* The state to which a control leads from x. */
static void advance(lfo_real *x, const lfo_real *u) {
  lfo_real next[N];
  for (int i = 0; i < N; i++) {
    next[i] = d[column[0] * N + i] + product(A + i * N, x, N);
    for (int j = 0; j < M; j++) next[i] += B[i * M + j] * (u[j] - product(K + j * N, x, N));
  }
  memcpy(x, next, sizeof next);
}

{% endif %}
/* Clip a control to the hard rows at time 0 that act on one control each; boxes come last, and hold. */
static void clip(const lfo_real *x, lfo_real *u) {
  for (int f = model.families - 1; f >= 0; f--) {
    int acting = 0, count = 0, bound = f * model.columns + column[0];
    lfo_real y, above, below;
    for (int j = 0; j < M; j++)
      if (D[f * M + j] < 0 || D[f * M + j] > 0) {
        acting = j;
        count++;
      }
    if (count != 1) continue;
    y = product(C + f * N, x, N) + D[f * M + acting] * (u[acting] - product(K + acting * N, x, N));
    above = limit_up[bound] < NONE ? 0 : y - upper[bound];
    below = limit_low[bound] < NONE ? 0 : lower[bound] - y;
    if (above > 0) u[acting] -= above / D[f * M + acting];
    if (below > 0) u[acting] += below / D[f * M + acting];
  }
}

void controller_begin(controller *c) {
  memset(c->start, 0, sizeof c->start);
  memset(c->last, 0, sizeof c->last);
  lfo_begin(&model, &c->memory, c->reals, c->members, c->flags);
}

{% if references %}
int controller_step(controller *c, const lfo_real x[N], const lfo_real reference[N], lfo_real u[M]) {
{% else %}
int controller_step(controller *c, const lfo_real x[N], lfo_real u[M]) {
{% endif %}
  lfo_real start[CONTROLLER_PARAMETERS], control[M];
  int status, finite = 1;
  for (int i = 0; i < N; i++) start[i] = (x[i] - origin[i]) / state_unit[i];
{% if references %}
  for (int i = 0; i < N; i++) start[N + i] = (reference[i] - origin[i]) / state_unit[i];
{% endif %}
  for (int i = 0; i < CONTROLLER_PARAMETERS; i++)
    finite &= start[i] >= -CONTROLLER_LARGEST && start[i] <= CONTROLLER_LARGEST;
  if (!finite) return CONTROLLER_NO_STATE;
{% if delay %}
  for (int j = 0; j < M; j++) control[j] = c->last[j] / control_unit[j];
  advance(start, control);
{% endif %}
  status = lfo_step(&model, &c->memory, start, control, 0);
  for (int j = 0; j < M; j++) finite &= control[j] - control[j] == 0;
  if (!finite) { /* sums have overflowed: begin anew */
    lfo_begin(&model, &c->memory, c->reals, c->members, c->flags);
    return CONTROLLER_NO_STATE;
  }
  memcpy(c->start, start, sizeof start);
  if (status != LFO_SOLVED) clip(start, control);
  for (int j = 0; j < M; j++) c->last[j] = u[j] = control[j] * control_unit[j];
  if (status == LFO_SOLVED) return c->memory.exceeded ? CONTROLLER_SOFTENED : CONTROLLER_PLANNED;
  return status == LFO_LIMIT ? CONTROLLER_CAPPED : CONTROLLER_INFEASIBLE;
}

void controller_plan(const controller *c, lfo_real *x, lfo_real *u) {
  const lfo_real *v = c->memory.plan;
  lfo_real state[N], next[N];
  memcpy(state, c->start, sizeof state);
  for (int t = 0; t <= CONTROLLER_HORIZON; t++) {
    for (int i = 0; i < N; i++) x[t * N + i] = state[i] * state_unit[i] + origin[i];
    if (t == CONTROLLER_HORIZON) break;
    for (int j = 0; j < M; j++) u[t * M + j] = (v[t * M + j] + product(K + j * N, state, N)) * control_unit[j];
    for (int i = 0; i < N; i++)
      next[i] = d[column[t] * N + i] + product(A + i * N, state, N) + product(B + i * M, v + t * M, M);
    memcpy(state, next, sizeof state);
  }
}
