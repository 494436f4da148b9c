/* {{ title }}

   {{ integers.n }} state(s), {{ integers.m }} control(s), horizon {{ integers["T"] }}, {{ integers.r }} unknowns, {{ real.name }}.
   Written by lin_freq_ocp {{ version }}; README.md has its problem, its sizes and its use. */
#ifndef CONTROLLER_H
#define CONTROLLER_H

#ifdef __cplusplus
extern "C" {
#endif

#include "lfo_settings.h"

#define CONTROLLER_STATES {{ integers.n }} /* of a plan */
#define CONTROLLER_MEASURED {{ measured }} /* of them: those of x */
#define CONTROLLER_CONTROLS {{ integers.m }}
#define CONTROLLER_HORIZON {{ integers["T"] }}
#define CONTROLLER_PARAMETERS {{ integers.p - 1 }} /* the state{{ " and the reference" if references }} */
#define CONTROLLER_LARGEST {{ real.literal(largest) }} /* of a state{{ " or reference" if references }}, in its unit */
#define CONTROLLER_TABLE_BYTES {{ summary.flash }}

/* The status of a step. */
enum {
  CONTROLLER_PLANNED = 0,    /* u is the first control of a plan that satisfies all rows */
  CONTROLLER_SOFTENED = 1,   /* the same, and soft rows are violated; controller_plan says by how much */
  CONTROLLER_CAPPED = 2,     /* the cap on changes was reached: the previous plan continues, with its feedback; */
                             /* or rounding hides the control of the plan: the feedback acts alone */
  CONTROLLER_INFEASIBLE = 3, /* hard rows contradict each other: the previous plan continues, with its feedback */
  CONTROLLER_NO_STATE = 4    /* an argument is not finite or too large: u is not changed, and acts again */
};

/* All memory of a controller. It has pointers into itself: never copy or move it after controller_begin. */
typedef struct {
  lfo_memory memory;
{% for kind, name, length, meaning in struct %}
  {{ kind }} {{ name }}[{{ length }}];{{ " /* " ~ meaning ~ " */" if meaning }}
{% endfor %}
} controller;
{% if memory %}

typedef char controller_fits[sizeof(controller) <= {{ memory }} ? 1 : -1]; /* the memory that was allowed */
{% endif %}

/* The length of an argument: a compiler warns of a shorter array. C++ has no such notation. */
#ifdef __cplusplus
#define CONTROLLER_LENGTH(length) length
#else
#define CONTROLLER_LENGTH(length) static length
#endif

/* Forget everything; call it before the first step. */
void controller_begin(controller *c);

{% if delay %}
/* Compute the control that acts one step after the measured state x. Until then the control before acts. */
{% else %}
/* Compute the control u for a measured state x. */
{% endif %}
{% if known %}
/* States that follow from the controls alone are kept inside: {{ integers.n - measured }} more than x has. */
{% endif %}
{% if references %}
/* ``reference`` is that of the measured states over the horizon, in place of the x_ref of the problem. */
int controller_step(controller *c, const lfo_real x[CONTROLLER_LENGTH(CONTROLLER_MEASURED)],
                    const lfo_real reference[CONTROLLER_LENGTH(CONTROLLER_MEASURED)],
                    lfo_real u[CONTROLLER_LENGTH(CONTROLLER_CONTROLS)]);
{% else %}
int controller_step(controller *c, const lfo_real x[CONTROLLER_LENGTH(CONTROLLER_MEASURED)],
                    lfo_real u[CONTROLLER_LENGTH(CONTROLLER_CONTROLS)]);
{% endif %}

/* Tell before the next step that another control acts in place of the one that was returned last. */
void controller_applied(controller *c, const lfo_real u[CONTROLLER_LENGTH(CONTROLLER_CONTROLS)]);

/* Copy the states (CONTROLLER_HORIZON + 1 rows) and controls (CONTROLLER_HORIZON rows) of the last plan. */
void controller_plan(const controller *c, lfo_real *x, lfo_real *u);

#ifdef __cplusplus
}
#endif

#endif
