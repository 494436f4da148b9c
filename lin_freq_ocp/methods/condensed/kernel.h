/* One step of a receding-horizon controller: C99, no heap, no recursion, of the library sqrt alone.

   minimise 1/2 |xi|^2 + penalties   over   lower <= y <= upper,   y = C x_t + D v_t at every time t = 0 .. T

   of the stable loop x_{t+1} = A x_t + B v_t + d_t, v = W (x_0, 1, xi). A bound of LFO_NONE in size is none, a limit of
   LFO_NONE makes a row hard. Windows limit the spectrum of the applied controls: hard rows on samples of the past and of
   the plan, whose last control is held. docs/condensed.md derives the method. */
#ifndef LFO_KERNEL_H
#define LFO_KERNEL_H

#ifndef LFO_REAL
#define LFO_REAL double
#define LFO_SQRT sqrt
#endif
#define LFO_QUEUE 4     /* violated rows that one sweep collects */
#define LFO_RUN 8       /* longer runs of violated soft rows are relaxed in one step */
#ifndef LFO_FAMILIES
#define LFO_FAMILIES 64 /* most families: rows of one (C, D) at all times */
#define LFO_STATES 64   /* most states */
#endif
#define LFO_NONE 1e30
#define LFO_FACETS 16   /* of the polygon in the disc |V| <= level */
#define LFO_RAISED 100  /* a past that exceeds a level by so many tolerances raises it; less is rounding */

typedef LFO_REAL lfo_real;

/* |V| <= 1, V = sum of taper_j exp(-i w j) v_(begin + j) / level at each point w, for windows of one control. A window begins
   every ``hop`` samples; so many have begun before a plan ends, and are not over. The last of all slots begins with the
   last control of the plan: it holds a constant. */
typedef struct {
  int length, hop, points, slots, component;
  int begin;                              /* of the oldest window at the first step, from the begin of the plan */
  int cell;                               /* the points of the windows before */
  const lfo_real *wave;                   /* taper_j cos(w j), -taper_j sin(w j) by the level, (length, 2 points) */
} lfo_windows;

typedef struct {
  int T, n, m, p, r, families, columns, most_active, most_changes;
  int sets, cells, inner;                 /* of windows; points of all windows; states that follow from controls alone */
  lfo_real tolerance, dependent;          /* of a row, relative to its size; of a gradient, relative to its length */
  const lfo_real *A, *B, *K, *d;          /* A + B K, B, K, offsets (columns, n); by rows */
  const lfo_real *W;                      /* v of (x_0, further parameters, 1, xi): p + r columns of T m */
  const lfo_real *E;                      /* response of a family to v of T, T-1 .. 0 times before, (families, T+1, m) */
  const lfo_real *C, *D, *size;           /* rows of the families, C with the feedback; units of their values */
  const lfo_real *lower, *upper;          /* (families, columns) */
  const lfo_real *limit_low, *limit_up;   /* of multipliers: the price of a unit of violation, (families, columns) */
  const lfo_windows *windows;             /* (sets) */
  const lfo_real *past;                   /* V of the samples before the first step, (2 cells), or none */
  const lfo_real *inner_A, *inner_C;        /* of states that follow from controls: A without feedback, rows */
  const short *inner_state, *of_controls;  /* (inner); of a family: 0, or j + 1 if it is control j, -1 if it depends on */
                                          /* several controls or on kept states, and on no other state */
  const short *column;                    /* (T+1): times with the same offsets, bounds and limits share a column */
} lfo_model;

/* The arrays of lfo_memory and their lengths: k = most_active; c = T m and a = k with windows, else 0. Q and R: gradients
   of the active rows as R'Q, Q orthonormal, R upper triangular. These lists make struct, allocation and size. */
#define LFO_ARRAYS(X) \
  X(xi, r) X(row, r) X(z, r) X(seen, r) X(base, T * m) X(plan, T * m) X(before, T * m) X(g, T * m) \
  X(d, k) X(w, k) X(e, k) X(lambda, k) X(Q, k * r) X(R, k * k) \
  X(control, c) X(old, c) X(force, c) X(sums, 2 * cells) X(hold, 2 * cells) X(V, 2 * cells) X(V_old, 2 * cells) \
  X(level, cells)
#define LFO_INDICES(X) X(member, k) X(again, a) X(first, sets) X(begin, sets)
#define LFO_FIELD(name, length) lfo_real *name;
#define LFO_INDEX(name, length) int *name;

typedef struct { /* all that lasts from step to step; the arrays are the caller's, their sizes from lfo_reals and lfo_rows */
  LFO_ARRAYS(LFO_FIELD)
  LFO_INDICES(LFO_INDEX)
  signed char *flag;                      /* a row: 0 inactive, +-2 active at its upper, lower bound, +-1 beyond it */
  int active, plans, changes, sweeps, exceeded;
  int stuck;                              /* after LFO_INFEASIBLE: the row that w times the active rows contradicts, */
                                          /* as row + 1 at its upper, -(row + 1) at its lower bound; else 0 */
  lfo_real worth;                         /* dual value of the multipliers at the last sweep */
  lfo_real rest;                          /* largest |V| of the rest of the plan before, by the polygon; above 1 it raises the level */
} lfo_memory;

enum { LFO_SOLVED = 0, LFO_LIMIT = 1, LFO_INFEASIBLE = 2 };

int lfo_reals(const lfo_model *p);
int lfo_integers(const lfo_model *p);
int lfo_rows(const lfo_model *p);
void lfo_begin(const lfo_model *p, lfo_memory *s, lfo_real *reals, int *integers, signed char *flags);
/* x: the measured state and further parameters, (p - 1); u: (m); states: of the plan, (T+1, n), or none. */
int lfo_step(const lfo_model *p, lfo_memory *s, const lfo_real *x, lfo_real *u, lfo_real *states);
/* With windows: the rest of the last plan, in place of a step; and the control that acts next, after every step. */
void lfo_go_on(const lfo_model *p, lfo_memory *s, lfo_real *u);
void lfo_apply(const lfo_model *p, lfo_memory *s, const lfo_real *u);
/* Of the rows of the families, (families, T+1). */
void lfo_multipliers(const lfo_model *p, const lfo_memory *s, lfo_real *out);

#endif
