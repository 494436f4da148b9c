/* The tables of a controller, and its step: lfo_kernel.c in the units of the problem. */
#include "controller.h"
#include <string.h>

#define N CONTROLLER_STATES
#define M CONTROLLER_CONTROLS
#define MEASURED CONTROLLER_MEASURED
#define LIMITS {{ limits }}
#define EPSILON {{ real.literal(real.epsilon) }}
#define LARGEST_TERM {{ real.literal(largest_term) }} /* of a control, in its unit */

{% for name, kind, values in tables %}
static const {{ kind }} {{ name }}[] = {
{% for line in values %}
  {{ line }}
{% endfor %}
};
{% endfor %}

{% if windows %}
static const lfo_windows windows[] = {
{% for set in windows %}
  { {%- for name, value in set.items() %}.{{ name }} = {{ value }}, {% endfor %}.wave = wave{{ loop.index0 }}},
{% endfor %}
};

{% endif %}
/* A state is (x - origin) times a power of two, a control u times one: changing units rounds nothing. */
static const lfo_model model = {
{% for name, value in integers.items() %}
  .{{ name }} = {{ value }},
{% endfor %}
{% for name, value in numbers.items() %}
  .{{ name }} = {{ real.literal(value) }},
{% endfor %}
{% for name in fields %}
  .{{ name }} = {{ name }},
{% endfor %}
{% if windows %}
  .windows = windows,
{% endif %}
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
  for (int i = 0; i < N; i++) next[i] = d[column[0] * N + i] + product(plant + i * N, x, N) + product(B + i * M, u, M);
  memcpy(x, next, sizeof next);
}

{% endif %}
/* Move a control inside its hard limits c'x + d u_j <= e at the state x, exactly; bounds come last, and hold. */
static void clip(const lfo_real *x, lfo_real *u) {
  for (int i = 0; i < LIMITS; i++) {
    lfo_real sum = limit_e[i], lost = 0, bound, *acting = u + limit_acting[i];
    for (int k = 0; k < N; k++) { /* e - c'x = sum + lost */
      lfo_real term = -limit_C[i * N + k] * x[k], next = sum + term, part = next - sum;
      lost += (sum - (next - part)) + (term - part);
      sum = next;
    }
    bound = sum / limit_D[i];
    if (lost < 0) bound -= (limit_D[i] > 0 ? EPSILON : -EPSILON) * (bound < 0 ? -bound : bound);
    if (limit_D[i] > 0 ? *acting > bound : *acting < bound) *acting = bound;
  }
}

/* Whether rounding hides the control of the plan: the state is far away, and its terms cancel. */
static int hidden(const lfo_real *plan, const lfo_real *x) {
  for (int j = 0; j < M; j++) {
    lfo_real terms = plan[j] < 0 ? -plan[j] : plan[j];
    for (int i = 0; i < N; i++) terms += K[j * N + i] * x[i] < 0 ? -K[j * N + i] * x[i] : K[j * N + i] * x[i];
    if (!(terms <= LARGEST_TERM)) return 1;
  }
  return 0;
}

void controller_begin(controller *c) {
  memset(c->start, 0, sizeof c->start);
  memset(c->last, 0, sizeof c->last);
{% if known %}
  memset(c->acted, 0, sizeof c->acted);
  memcpy(c->kept, kept_begin, sizeof c->kept);
{% endif %}
{% if known or windows %}
  c->begun[0] = 0;
{% endif %}
  lfo_begin(&model, &c->memory, c->reals, c->members, c->flags);
}

void controller_applied(controller *c, const lfo_real u[CONTROLLER_LENGTH(M)]) { memcpy(c->last, u, sizeof c->last); }

{% if known %}
/* The whole state: states that follow from the controls alone go on by the control that acted. */
static void complete(controller *c, const lfo_real *measured, lfo_real *x) {
  lfo_real next[N - MEASURED];
  const lfo_real *acted = {{ "c->acted" if delay else "c->last" }};
  for (int i = 0; c->begun[0] && i < N - MEASURED; i++)
    next[i] = kept_d[i] + product(kept_A + i * (N - MEASURED), c->kept, N - MEASURED) + product(kept_B + i * M, acted, M);
  if (c->begun[0]) memcpy(c->kept, next, sizeof next);
  memcpy(c->acted, c->last, sizeof c->last);
  for (int i = 0; i < N; i++) x[i] = place[i] < MEASURED ? measured[place[i]] : c->kept[place[i] - MEASURED];
}

{% endif %}
int controller_step(controller *c, const lfo_real measured[CONTROLLER_LENGTH(MEASURED)],
{% if references %}
                    const lfo_real reference[CONTROLLER_LENGTH(MEASURED)],
{% endif %}
                    lfo_real u[CONTROLLER_LENGTH(M)]) {
{% if known or windows %}
  lfo_real x[N];
{% else %}
  const lfo_real *x = measured;
{% endif %}
  lfo_real start[CONTROLLER_PARAMETERS], control[M]{{ ", begin[N]" if delay }};
  int status, finite = 1;
{% if known %}
  complete(c, measured, x);
{% elif windows %}
  memcpy(x, measured, sizeof x);
{% endif %}
{% if windows %}
  for (int j = 0; j < M; j++) control[j] = c->last[j] / control_unit[j];
  if (c->begun[0]) lfo_apply(&model, &c->memory, control);
{% endif %}
{% if known or windows %}
  c->begun[0] = 1;
{% endif %}
  for (int i = 0; i < N; i++) start[i] = (x[i] - origin[i]) / state_unit[i];
{% if references %}
{% for i in at_measured %}
  start[N + {{ loop.index0 }}] = (reference[{{ loop.index0 }}] - origin[{{ i }}]) / state_unit[{{ i }}];
{% endfor %}
{% endif %}
  for (int i = 0; i < CONTROLLER_PARAMETERS; i++)
    finite &= start[i] >= -CONTROLLER_LARGEST && start[i] <= CONTROLLER_LARGEST;
{% if windows %}
  for (int i = 0; !finite && i < N; i++) { /* no row of measured states is kept */
    if ({{ "place[i] < MEASURED" if known else "1" }}) x[i] = origin[i];
    start[i] = (x[i] - origin[i]) / state_unit[i];
  }
{% else %}
  if (!finite) return CONTROLLER_NO_STATE;
{% endif %}
{% if delay %}
  for (int j = 0; j < M; j++) control[j] = c->last[j] / control_unit[j];
  advance(start, control);
{% endif %}
{% if windows %}
  if (finite)
    status = lfo_step(&model, &c->memory, start, control, 0);
  else
    status = LFO_INFEASIBLE, lfo_go_on(&model, &c->memory, control);
  if (status == LFO_SOLVED && hidden(c->memory.plan, start)) status = LFO_LIMIT; /* its windows hold all the same */
{% else %}
  status = lfo_step(&model, &c->memory, start, control, 0);
  for (int j = 0; j < M; j++) finite &= control[j] - control[j] == 0;
  if (!finite) { /* sums have overflowed: begin anew */
    lfo_begin(&model, &c->memory, c->reals, c->members, c->flags);
    return CONTROLLER_NO_STATE;
  }
  if (status == LFO_SOLVED && hidden(c->memory.plan, start)) {
    memset(c->memory.plan, 0, sizeof(lfo_real) * CONTROLLER_HORIZON * M);
    for (int j = 0; j < M; j++) control[j] = product(K + j * N, start, N);
    status = LFO_LIMIT;
  }
{% endif %}
  memcpy(c->start, start, sizeof start);
  for (int j = 0; j < M; j++) u[j] = control[j] * control_unit[j];
{% if delay %}
  for (int i = 0; i < N; i++) begin[i] = start[i] * state_unit[i] + origin[i];
  clip(begin, u);
{% else %}
  clip(x, u);
{% endif %}
  memcpy(c->last, u, sizeof c->last);
{% if windows %}
  if (!finite) return CONTROLLER_NO_STATE;
{% endif %}
  if (status == LFO_SOLVED) return c->memory.exceeded{{ " || c->memory.rest > 1 + LFO_RAISED * model.tolerance" if windows }} ? CONTROLLER_SOFTENED : CONTROLLER_PLANNED;
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
