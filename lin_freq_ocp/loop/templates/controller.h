/* {{ title }}

   {{ integers.n }} state(s), {{ integers.m }} control(s), horizon {{ integers["T"] }}, {{ integers.r }} unknowns, {{ real.name }}.
   Written by lin_freq_ocp {{ version }}; README.md has its problem, its sizes and its use. */
#ifndef CONTROLLER_H
#define CONTROLLER_H

#ifdef __cplusplus
extern "C" {
#endif

#include "lfo_settings.h"

#define CONTROLLER_STATES {{ integers.n }}
#define CONTROLLER_CONTROLS {{ integers.m }}
#define CONTROLLER_HORIZON {{ integers["T"] }}
#define CONTROLLER_REALS {{ reals }}
#define CONTROLLER_MEMBERS {{ [integers.most_active, 1] | max }}
#define CONTROLLER_ROWS {{ [rows, 1] | max }}
#define CONTROLLER_PARAMETERS {{ integers.p - 1 }} /* the state{{ " and its reference" if references }} */
#define CONTROLLER_LARGEST {{ real.literal(largest) }} /* of a state{{ " or reference" if references }}, in its unit */
#define CONTROLLER_TABLE_BYTES {{ summary.flash }}

/* The status of a step. */
enum {
  CONTROLLER_PLANNED = 0,    /* u is the first control of a plan that satisfies all rows */
  CONTROLLER_SOFTENED = 1,   /* the same, and soft rows are violated; controller_plan says by how much */
  CONTROLLER_CAPPED = 2,     /* the cap on changes was reached: the previous plan continues, with its feedback; */
                             /* or rounding hides the control of the plan: the feedback acts alone */
  CONTROLLER_INFEASIBLE = 3, /* hard rows contradict each other: the previous plan continues, with its feedback */
  CONTROLLER_NO_STATE = 4    /* an argument is not finite or too large: u and the controller are not changed */
};

/* All memory of a controller. It has pointers into itself: never copy or move it after controller_begin. */
typedef struct {
  lfo_memory memory;
  lfo_real start[CONTROLLER_PARAMETERS]; /* where the last plan begins, in units of order 1 */
  lfo_real last[CONTROLLER_CONTROLS];    /* the control returned last, in its units */
  lfo_real reals[CONTROLLER_REALS];
  int members[CONTROLLER_MEMBERS];
  signed char flags[CONTROLLER_ROWS];
} controller;

/* Forget everything; call it before the first step. */
void controller_begin(controller *c);

{% if known %}
/* A state x has CONTROLLER_STATES entries, more than a plant without {{ known | join(", ") }}: these follow from the
   controls before alone, such as the control that acted at the last step. Your program sets them at every step. */
{% endif %}
{% if delay %}
/* Compute the control that acts one step after the measured state x. Until then the control before acts; set c->last
   if another one does. */
{% else %}
/* Compute the control u for a measured state x. */
{% endif %}
{% if references %}
/* ``reference`` is that of the states over the horizon, in place of the x_ref of the problem. */
int controller_step(controller *c, const lfo_real x[CONTROLLER_STATES], const lfo_real reference[CONTROLLER_STATES],
                    lfo_real u[CONTROLLER_CONTROLS]);
{% else %}
int controller_step(controller *c, const lfo_real x[CONTROLLER_STATES], lfo_real u[CONTROLLER_CONTROLS]);
{% endif %}

/* Copy the states (CONTROLLER_HORIZON + 1 rows) and controls (CONTROLLER_HORIZON rows) of the last plan. */
void controller_plan(const controller *c, lfo_real *x, lfo_real *u);

#ifdef __cplusplus
}
#endif

#endif
