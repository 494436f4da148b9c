/* A dual active-set method in few unknowns (Goldfarb and Idnani 1983), from the multipliers of the step before.

   The gradients of the rows are never stored: y comes from a sweep forward through the stable loop, a gradient and
   sums of multipliers times gradients from a sweep backward. A soft row is one whose multiplier has a limit, its
   price. Multipliers within their limits stay so whatever is measured: every step begins with those of the last. */
#include "kernel.h"
#include <math.h>
#include <string.h>

#define NONE ((lfo_real)LFO_NONE)
#define LEVEL ((lfo_real)0.98078528040323044) /* of a facet, for |V| <= 1: cos(pi / LFO_FACETS) */
#define BYTES(count) (sizeof(lfo_real) * (size_t)(count))

enum { ENTERED, ROUNDING, STUCK };

typedef struct { /* the worst row of a run of violated rows of one family */
  int row;
  int begin, end, state;            /* times of the run; the flag of its rows, or their side if they are inactive */
  lfo_real y, violation, worth;     /* of the worst row; limits times violations of all of them */
} candidate;

static lfo_real absolute(lfo_real a) { return a < 0 ? -a : a; }

static lfo_real dot(const lfo_real *a, const lfo_real *b, int count) {
#ifdef LFO_SIMD
  lfo_real sum = 0;
#pragma omp simd reduction(+ : sum)
  for (int i = 0; i < count; i++) sum += a[i] * b[i];
  return sum;
#else /* four independent sums */
  lfo_real s0 = 0, s1 = 0, s2 = 0, s3 = 0;
  int i = 0;
  for (; i + 3 < count; i += 4) {
    s0 += a[i] * b[i];
    s1 += a[i + 1] * b[i + 1];
    s2 += a[i + 2] * b[i + 2];
    s3 += a[i + 3] * b[i + 3];
  }
  for (; i < count; i++) s0 += a[i] * b[i];
  return (s0 + s1) + (s2 + s3);
#endif
}

static void add(lfo_real *restrict a, lfo_real factor, const lfo_real *restrict b, int count) {
  for (int i = 0; i < count; i++) a[i] += factor * b[i];
}

#define LENGTH(name, length) +(length)

int lfo_reals(const lfo_model *p) {
  int r = p->r, T = p->T, m = p->m, k = p->most_active, cells = p->cells, c = p->sets ? T * m : 0;
  return 0 LFO_ARRAYS(LENGTH);
}

int lfo_integers(const lfo_model *p) {
  int k = p->most_active, sets = p->sets, a = sets ? k : 0;
  return 0 LFO_INDICES(LENGTH);
}

static int stage_rows(const lfo_model *p) { return p->families * (p->T + 1); }

int lfo_rows(const lfo_model *p) { return stage_rows(p) + p->cells * LFO_FACETS; }

void lfo_begin(const lfo_model *p, lfo_memory *s, lfo_real *reals, int *integers, signed char *flags) {
  int r = p->r, T = p->T, m = p->m, k = p->most_active, cells = p->cells, sets = p->sets;
  int c = sets ? T * m : 0, a = sets ? k : 0;
  memset(s, 0, sizeof *s);
#define PLACE(name, length) s->name = reals, reals += length;
  LFO_ARRAYS(PLACE)
#define PLACE_INDEX(name, length) s->name = integers, integers += length;
  LFO_INDICES(PLACE_INDEX)
  s->flag = flags;
  memset(flags, 0, (size_t)lfo_rows(p));
  memset(s->old, 0, BYTES(c)); /* the first plan at rest: no control acts */
  memset(s->sums, 0, BYTES(2 * cells));
  if (p->past) memcpy(s->sums, p->past, BYTES(2 * cells));
  for (int i = 0; i < sets; i++) {
    s->first[i] = 0;
    s->begin[i] = p->windows[i].begin;
  }
}

/* Where the bounds and limits of a row are. */
static int bound_of(const lfo_model *p, int row) {
  return row / (p->T + 1) * p->columns + p->column[row % (p->T + 1)];
}

static lfo_real limit_of(const lfo_model *p, int row, int side) {
  if (row >= stage_rows(p)) return NONE;
  return (side > 0 ? p->limit_up : p->limit_low)[bound_of(p, row)];
}

/* A facet of the polygon of a point of a window. */
typedef struct {
  const lfo_windows *w;
  int cell, begin, re, im; /* the point; the window's begin, from that of the plan; where Re V and Im V are in arrays */
  lfo_real cosine, sine; /* the direction of the facet */
} facet;

static const lfo_windows *windows_of(const lfo_model *p, int cell) {
  const lfo_windows *w = p->windows;
  while (cell >= w->cell + w->slots * w->points) w++;
  return w;
}

/* When a window begins: the windows of a set lie in a ring, but for the last one, of a constant. */
static int begin_of(const lfo_model *p, const lfo_memory *s, const lfo_windows *w, int slot) {
  int i = (int)(w - p->windows), ring = w->slots - 1;
  return slot == ring ? p->T - 1 : s->begin[i] + (slot - s->first[i] + ring) % ring * w->hop;
}

static void turn(facet *f, int part) {
  static const lfo_real circle[] = {(lfo_real)1, (lfo_real)0.92387953251128674, (lfo_real)0.70710678118654752,
                                    (lfo_real)0.38268343236508977, (lfo_real)0};
  int eighth = part % 8;
  lfo_real turned = part < 8 ? 1 : -1;
  f->cosine = turned * (eighth <= 4 ? circle[eighth] : -circle[8 - eighth]);
  f->sine = turned * (eighth <= 4 ? circle[4 - eighth] : circle[eighth - 4]);
}

static facet facet_of(const lfo_model *p, const lfo_memory *s, int row) {
  int cell = (row - stage_rows(p)) / LFO_FACETS, slot;
  const lfo_windows *w = windows_of(p, cell);
  facet f;
  slot = (cell - w->cell) / w->points;
  f.w = w;
  f.cell = cell;
  f.begin = begin_of(p, s, w, slot);
  f.re = cell + w->cell + slot * w->points;
  f.im = f.re + w->points;
  turn(&f, (row - stage_rows(p)) % LFO_FACETS);
  return f;
}

static lfo_real facet_value(const facet *f, const lfo_real *V) { return f->cosine * V[f->re] + f->sine * V[f->im]; }

static lfo_real size_of(const lfo_model *p, int row) {
  return row < stage_rows(p) ? p->size[row / (p->T + 1)] : 1;
}

static lfo_real bound_at(const lfo_model *p, const lfo_memory *s, int row, int side) {
  if (row < stage_rows(p)) return (side > 0 ? p->upper : p->lower)[bound_of(p, row)];
  return s->level[(row - stage_rows(p)) / LFO_FACETS];
}

/* The position of an active row among all of them. */
static int position(const lfo_memory *s, int row) {
  int k = 0;
  while (s->member[k] != row) k++;
  return k;
}

/* Insert the worst row of a run that has ended into the queue, the worst first; return the length of the queue. */
static int queued(candidate *queue, int count, candidate *run) {
  int i = count < LFO_QUEUE ? count : queue[count - 1].violation < run->violation ? count - 1 : -1;
  if (!(run->violation > 0) || i < 0) return count;
  if (count < LFO_QUEUE) count++;
  for (; i > 0 && queue[i - 1].violation < run->violation; i--) queue[i] = queue[i - 1];
  queue[i] = *run;
  run->violation = 0;
  return count;
}

/* V of a window for the controls u (T m) of a plan. */
static void window_value(const lfo_model *p, const lfo_memory *s, const lfo_windows *w, int slot, const lfo_real *u,
                         lfo_real *V) {
  int begin = begin_of(p, s, w, slot), both = 2 * w->points, at = 2 * w->cell + slot * both;
  int from = begin > 0 ? begin : 0, to = begin + w->length < p->T ? begin + w->length : p->T;
  memcpy(V + at, s->sums + at, BYTES(both));
  for (int t = from; t < to; t++) add(V + at, u[t * p->m + w->component], w->wave + (t - begin) * both, both);
  add(V + at, u[(p->T - 1) * p->m + w->component], s->hold + at, both);
}

static void all_windows(const lfo_model *p, const lfo_memory *s, const lfo_real *u, lfo_real *V) {
  for (const lfo_windows *w = p->windows; w < p->windows + p->sets; w++)
    for (int slot = 0; slot < w->slots; slot++) window_value(p, s, w, slot, u, V);
}

/* Values of all windows: the distance of active rows; the worst point of each window may enter the queue. */
static int window_sweep(const lfo_model *p, lfo_memory *s, candidate *queue, int count) {
  all_windows(p, s, s->control, s->V);
  for (const lfo_windows *w = p->windows; w < p->windows + p->sets; w++)
    for (int slot = 0; slot < w->slots; slot++) {
      candidate worst = {0};
      if (begin_of(p, s, w, slot) >= p->T) continue;
      for (int point = 0; point < w->points; point++) {
        int cell = w->cell + slot * w->points + point, re = cell + w->cell + slot * w->points, im = re + w->points;
        int row = stage_rows(p) + cell * LFO_FACETS;
        lfo_real known = s->level[cell] + (worst.violation > 0 ? worst.violation : p->tolerance);
        facet f;
        if (s->V[re] * s->V[re] + s->V[im] * s->V[im] <= known * known) continue;
        f = facet_of(p, s, row);
        for (int i = 0; i < LFO_FACETS; i++) {
          lfo_real y = (turn(&f, i), facet_value(&f, s->V));
          if (s->flag[row + i] || y <= known) continue;
          worst.row = row + i;
          worst.state = 1;
          worst.y = known = y;
          worst.violation = y - s->level[cell];
        }
      }
      count = queued(queue, count, &worst);
    }
  for (int i = 0; i < s->active; i++)
    if (s->member[i] >= stage_rows(p)) {
      facet f = facet_of(p, s, s->member[i]);
      s->e[i] = s->level[f.cell] - facet_value(&f, s->V);
      s->worth -= s->lambda[i] * s->e[i];
    }
  return count;
}

/* a + b, and 0 where they cancel up to rounding: a row with no other coefficient depends on nothing. */
static lfo_real sum_of(const lfo_model *p, lfo_real a, lfo_real b) {
  return absolute(a + b) > p->tolerance * (absolute(a) + absolute(b)) ? a + b : 0;
}

/* Add a multiple of a row of a window to the forces on the controls. */
static void add_force(const lfo_model *p, lfo_memory *s, int row, lfo_real factor) {
  facet f = facet_of(p, s, row);
  const lfo_windows *w = f.w;
  lfo_real a = factor * f.cosine, b = factor * f.sine, *force = s->force + w->component;
  int P = w->points, point = f.re - 2 * w->cell, end = f.begin + w->length;
  point %= 2 * P;
  for (int t = f.begin > 0 ? f.begin : 0; t < p->T && t < end; t++) {
    const lfo_real *wave = w->wave + (t - f.begin) * 2 * P;
    force[t * p->m] += sum_of(p, a * wave[point], b * wave[P + point]);
  }
  force[(p->T - 1) * p->m] += sum_of(p, a * s->hold[f.re], b * s->hold[f.im]);
}

/* Simulate the plan v of xi. Active rows get their distance to the bound, e; the worst rows of runs of violated ones
   fill the queue. Return the length of the queue. */
static int sweep(const lfo_model *p, lfo_memory *s, const lfo_real *x0, candidate *queue, lfo_real *states) {
  int T = p->T, n = p->n, m = p->m, count = 0;
  lfo_real x[LFO_STATES], next[LFO_STATES];
  candidate runs[LFO_FAMILIES];
  memcpy(s->plan, s->base, BYTES(T * m));
  for (int j = 0; j < p->r; j++) add(s->plan, s->xi[j], p->W + (p->p + j) * T * m, T * m);
  memcpy(s->seen, s->xi, BYTES(p->r));
  memcpy(x, x0, BYTES(n));
  for (int f = 0; f < p->families; f++) runs[f].violation = 0;
  s->sweeps++;
  s->exceeded = 0;
  s->worth = dot(s->xi, s->xi, p->r) / 2;
  for (int t = 0; t <= T; t++) {
    const lfo_real *v = s->plan + t * m, *d = p->d + p->column[t] * n;
    if (states) memcpy(states + t * n, x, BYTES(n));
    for (int j = 0; p->sets && t < T && j < m; j++) s->control[t * m + j] = v[j] + dot(p->K + j * n, x, n);
    for (int f = 0; f < p->families; f++) {
      int row = f * (T + 1) + t, bound = f * p->columns + p->column[t], flag = s->flag[row], state;
      candidate *run = runs + f;
      lfo_real y, above, below, violation;
      if (p->upper[bound] >= NONE && p->lower[bound] <= -NONE) {
        count = queued(queue, count, run);
        run->violation = 0;
        continue;
      }
      y = dot(p->C + f * n, x, n) + (t < T ? dot(p->D + f * m, v, m) : 0);
      above = y - p->upper[bound];
      below = p->lower[bound] - y;
      if (flag == 2 || flag == -2) {
        int i = position(s, row);
        s->e[i] = flag > 0 ? -above : below;
        s->worth -= s->lambda[i] * s->e[i];
        continue;
      }
      if (flag) {
        s->worth += limit_of(p, row, flag) * (flag > 0 ? above : below);
        s->exceeded++;
      }
      violation = flag == 0 ? (above > below ? above : below) : flag > 0 ? -above : -below;
      state = flag == 0 ? (above > below ? 1 : -1) : 2 * flag;
      if (violation <= p->tolerance * p->size[f] || (run->violation > 0 && state != run->state)) {
        count = queued(queue, count, run);
        run->violation = 0;
      }
      if (violation <= p->tolerance * p->size[f]) continue;
      if (!(run->violation > 0)) {
        run->begin = t;
        run->state = state;
        run->worth = 0;
      }
      run->end = t;
      run->worth += limit_of(p, row, state) * violation;
      if (violation / p->size[f] > run->violation) {
        run->row = row;
        run->y = y;
        run->violation = violation / p->size[f];
      }
    }
    if (t == T) break;
    for (int i = 0; i < n; i++) next[i] = d[i] + dot(p->A + i * n, x, n) + dot(p->B + i * m, v, m);
    memcpy(x, next, BYTES(n));
  }
  for (int f = 0; f < p->families; f++) count = queued(queue, count, runs + f);
  return p->sets ? window_sweep(p, s, queue, count) : count;
}

/* The multiplier of a row with its sign: above zero at the upper bound. */
static lfo_real multiplier(const lfo_model *p, const lfo_memory *s, int row) {
  int flag = s->flag[row];
  if (flag == 2 || flag == -2) return s->lambda[position(s, row)];
  return flag ? (lfo_real)flag * limit_of(p, row, flag) : 0;
}

void lfo_multipliers(const lfo_model *p, const lfo_memory *s, lfo_real *out) {
  for (int row = 0; row < stage_rows(p); row++) out[row] = multiplier(p, s, row);
}

/* Forces on the controls, and with ``rows`` multipliers of the stage rows, as slopes in v, g, by a sweep backward. */
static void slopes(const lfo_model *p, lfo_memory *s, int rows) {
  int T = p->T, n = p->n, m = p->m;
  lfo_real q[LFO_STATES] = {0}, before[LFO_STATES];
  for (int t = T; t >= 0; t--) {
    lfo_real *g = s->g + t * m;
    if (t < T) {
      memset(g, 0, BYTES(m));
      memset(before, 0, BYTES(n));
      for (int i = 0; i < n; i++) {
        add(g, q[i], p->B + i * m, m);
        add(before, q[i], p->A + i * n, n);
      }
      memcpy(q, before, BYTES(n));
      for (int j = 0; p->sets && j < m; j++) {
        g[j] += s->force[t * m + j];
        add(q, s->force[t * m + j], p->K + j * n, n);
      }
    }
    for (int f = 0; rows && f < p->families; f++) {
      int row = f * (T + 1) + t;
      lfo_real lambda;
      if (!s->flag[row]) continue;
      lambda = multiplier(p, s, row);
      add(q, lambda, p->C + f * n, n);
      if (t < T) add(g, lambda, p->D + f * m, m);
    }
  }
}

/* xi = -(multipliers times gradients) */
static void from_multipliers(const lfo_model *p, lfo_memory *s) {
  int Tm = p->T * p->m;
  if (p->sets) memset(s->force, 0, BYTES(Tm));
  for (int i = 0; i < s->active; i++)
    if (s->member[i] >= stage_rows(p)) add_force(p, s, s->member[i], s->lambda[i]);
  slopes(p, s, 1);
  for (int j = 0; j < p->r; j++) s->xi[j] = -dot(s->g, p->W + (p->p + j) * Tm, Tm);
}

/* The gradient of a row against the columns of W: its response E, from its time back; of a window, its forces. */
static void gradient(const lfo_model *p, lfo_memory *s, int row) {
  int T = p->T, m = p->m, t = row % (T + 1), used = t < T ? t + 1 : T;
  const lfo_real *response = p->E + (row - t + T - t) * m;
  if (row >= stage_rows(p)) {
    memset(s->force, 0, BYTES(T * m));
    add_force(p, s, row, 1);
    slopes(p, s, 0);
    response = s->g;
    used = T;
  }
  for (int j = 0; j < p->r; j++) s->row[j] = dot(response, p->W + (p->p + j) * T * m, used * m);
}

/* Split a gradient: z is its part outside of the span of the active ones, d its coefficients in Q. Return |z|^2.
   One pass of modified Gram-Schmidt is enough: a row that depends on others is never appended. */
static lfo_real split(const lfo_model *p, lfo_memory *s) {
  int r = p->r, k = s->active;
  memcpy(s->z, s->row, BYTES(r));
  for (int i = 0; i < k; i++) {
    s->d[i] = dot(s->Q + i * r, s->z, r);
    add(s->z, -s->d[i], s->Q + i * r, r);
  }
  return dot(s->z, s->z, r);
}

/* Append the row whose gradient has been split, with |z| = rho. */
static void append(const lfo_model *p, lfo_memory *s, lfo_real rho, int row, int side, lfo_real lambda) {
  int r = p->r, k = s->active++;
  lfo_real *column = s->R + k * p->most_active;
  memcpy(column, s->d, BYTES(k));
  column[k] = rho;
  for (int j = 0; j < r; j++) s->Q[k * r + j] = s->z[j] / rho;
  s->member[k] = row;
  s->lambda[k] = lambda;
  s->flag[row] = (signed char)(2 * side);
}

/* Remove an active row by Givens rotations; its flag becomes ``rest``. */
static void drop(const lfo_model *p, lfo_memory *s, int c, int rest) {
  int r = p->r, most = p->most_active, k = --s->active;
  s->flag[s->member[c]] = (signed char)rest;
  for (int j = c; j < k; j++) {
    memcpy(s->R + j * most, s->R + (j + 1) * most, BYTES(j + 2));
    s->member[j] = s->member[j + 1];
    s->lambda[j] = s->lambda[j + 1];
    s->e[j] = s->e[j + 1];
  }
  for (int i = c; i < k; i++) {
    lfo_real a = s->R[i * most + i], b = s->R[i * most + i + 1], h = (lfo_real)LFO_SQRT(a * a + b * b);
    lfo_real cosine = a / h, sine = b / h, *q0 = s->Q + i * r, *q1 = q0 + r;
    for (int j = i; j < k; j++) {
      lfo_real *at = s->R + j * most + i, first = at[0], second = at[1];
      at[0] = cosine * first + sine * second;
      at[1] = cosine * second - sine * first;
    }
    for (int j = 0; j < r; j++) {
      lfo_real first = q0[j], second = q1[j];
      q0[j] = cosine * first + sine * second;
      q1[j] = cosine * second - sine * first;
    }
  }
}

/* w <- R^-1 w */
static void upper_solve(const lfo_model *p, const lfo_memory *s, lfo_real *w) {
  for (int j = s->active - 1; j >= 0; j--) {
    w[j] /= s->R[j * p->most_active + j];
    add(w, -w[j], s->R + j * p->most_active, j);
  }
}

/* w <- R'^-1 w */
static void lower_solve(const lfo_model *p, const lfo_memory *s, lfo_real *w) {
  for (int j = 0; j < s->active; j++)
    w[j] = (w[j] - dot(w, s->R + j * p->most_active, j)) / s->R[j * p->most_active + j];
}

/* The first active multiplier that reaches an end of its interval on the way rate * step; it shortens the step. */
static int first_block(const lfo_model *p, const lfo_memory *s, const lfo_real *rate, lfo_real *step, int *rest) {
  int blocking = -1;
  for (int j = 0; j < s->active; j++) {
    int side = s->flag[s->member[j]] > 0 ? 1 : -1;
    lfo_real value = (lfo_real)side * s->lambda[j], speed = (lfo_real)side * rate[j], way;
    lfo_real limit = limit_of(p, s->member[j], side);
    if (speed < 0)
      way = value / -speed;
    else if (speed > 0 && limit < NONE)
      way = (limit - value) / speed;
    else
      continue;
    if (way < 0) way = 0;
    if (way < *step) {
      *step = way;
      *rest = speed < 0 ? 0 : side;
      blocking = j;
    }
  }
  return blocking;
}

/* Move the multipliers until the active rows are at their bounds; rows whose multiplier ends leave. */
static void correct(const lfo_model *p, lfo_memory *s) {
  while (s->active) {
    int k = s->active, rest = 0, leaving;
    lfo_real step = 1;
    memcpy(s->d, s->e, BYTES(k));
    lower_solve(p, s, s->d); /* the way of xi in Q */
    for (int j = 0; j < k; j++) s->w[j] = -s->d[j];
    upper_solve(p, s, s->w); /* the way of lambda */
    leaving = first_block(p, s, s->w, &step, &rest);
    add(s->lambda, step, s->w, k);
    for (int j = 0; j < k; j++) add(s->xi, step * s->d[j], s->Q + j * p->r, p->r);
    if (leaving < 0) return;
    for (int j = 0; j < k; j++) s->e[j] *= 1 - step;
    drop(p, s, leaving, rest);
    s->changes++;
  }
}

/* Bring a violated row to its bound. ROUNDING: it depends on active rows, and is violated by rounding alone. */
static int enter(const lfo_model *p, lfo_memory *s, const candidate *c) {
  int r = p->r, flag = s->flag[c->row], side, rest = 0;
  lfo_real y = c->y, bound, limit, lambda, length, sigma, moved = 0, allowed = p->tolerance * size_of(p, c->row);
  gradient(p, s, c->row);
  for (int j = 0; j < r; j++) s->z[j] = s->xi[j] - s->seen[j];
  y += dot(s->row, s->z, r); /* since the sweep */
  side = flag ? flag : y > bound_at(p, s, c->row, 1) || c->row >= stage_rows(p) ? 1 : -1;
  limit = limit_of(p, c->row, side);
  bound = bound_at(p, s, c->row, side);
  sigma = flag ? (lfo_real)-flag : (lfo_real)side;
  if (sigma * (y - bound) <= allowed) return ENTERED;
  lambda = flag ? (lfo_real)flag * limit : 0;
  length = dot(s->row, s->row, r);
  while (++s->changes <= p->most_changes) {
    lfo_real rho2 = split(p, s), full = NONE, step;
    int leaving, independent = rho2 > p->dependent * p->dependent * length && s->active < p->most_active;
    memcpy(s->w, s->d, BYTES(s->active));
    upper_solve(p, s, s->w);
    for (int j = 0; j < s->active; j++) s->w[j] *= -sigma;
    if (independent) full = absolute(y - bound) / rho2;
    step = limit < NONE && limit - moved < full ? limit - moved : full;
    leaving = first_block(p, s, s->w, &step, &rest);
    if (leaving < 0 && step >= NONE) {
      if (absolute(y - bound) <= 100 * allowed) return ROUNDING;
      s->stuck = side * (c->row + 1);
      return STUCK;
    }
    add(s->lambda, step, s->w, s->active);
    if (independent) {
      add(s->xi, -sigma * step, s->z, r);
      y -= sigma * step * rho2;
    }
    lambda += sigma * step;
    moved += step;
    if (leaving >= 0) {
      drop(p, s, leaving, rest);
      continue;
    }
    if (step < full)
      s->flag[c->row] = (signed char)(flag ? 0 : side); /* its multiplier has reached its other end */
    else
      append(p, s, (lfo_real)LFO_SQRT(rho2), c->row, side, lambda);
    return ENTERED;
  }
  return ENTERED;
}

/* Let a whole run of soft rows exceed their bounds, if all multipliers at their limits are an ascent. Return whether. */
static int relaxed_run(const lfo_model *p, lfo_memory *s, const candidate *c) {
  int T = p->T, m = p->m, r = p->r, rest = 0, first = c->row / (T + 1) * (T + 1);
  lfo_real step = 1, worth = c->worth, sigma;
  if (c->row >= stage_rows(p) || c->end - c->begin < LFO_RUN || (c->state != 1 && c->state != -1)) return 0;
  sigma = (lfo_real)c->state;
  memset(s->g, 0, BYTES(T * m));
  for (int t = c->begin; t <= c->end; t++) {
    lfo_real limit = limit_of(p, first + t, c->state);
    if (s->flag[first + t] || limit >= NONE) return 0; /* another row of the queue has changed it, or it is hard */
    add(s->g, limit, p->E + (first + T - t) * m, (t < T ? t + 1 : T) * m);
  }
  for (int j = 0; j < r; j++) s->row[j] = dot(s->g, p->W + (p->p + j) * T * m, T * m);
  for (int j = 0; j < r; j++) worth += sigma * s->row[j] * (s->xi[j] - s->seen[j]);
  if (split(p, s) > worth) return 0;
  memcpy(s->w, s->d, BYTES(s->active));
  upper_solve(p, s, s->w);
  for (int j = 0; j < s->active; j++) s->w[j] *= -sigma;
  if (first_block(p, s, s->w, &step, &rest) >= 0) return 0;
  add(s->lambda, 1, s->w, s->active);
  add(s->xi, -sigma, s->z, r);
  for (int t = c->begin; t <= c->end; t++) s->flag[first + t] = (signed char)c->state;
  s->changes++;
  return 1;
}

/* Before a step: what the rest of the last plan makes of the windows, whose levels it keeps, whatever the past is. A window is the same row one step later, with other
   coefficients: active ones leave, and come back with new gradients and their multipliers. */
static void begin_windows(const lfo_model *p, lfo_memory *s) {
  int again = 0;
  memset(s->hold, 0, BYTES(2 * p->cells));
  s->rest = 0;
  for (const lfo_windows *w = p->windows; w < p->windows + p->sets; w++)
    for (int slot = 0; slot < w->slots; slot++) {
      int both = 2 * w->points, begin = begin_of(p, s, w, slot);
      lfo_real *hold = s->hold + 2 * w->cell + slot * both, *V = s->V_old + 2 * w->cell + slot * both;
      for (int j = p->T > begin ? p->T - begin : 0; j < w->length; j++) add(hold, 1, w->wave + j * both, both);
      window_value(p, s, w, slot, s->old, s->V_old);
      for (int point = 0; point < w->points; point++) {
        int cell = w->cell + slot * w->points + point, row = stage_rows(p) + cell * LFO_FACETS;
        lfo_real re = V[point], im = V[w->points + point], *level = s->level + cell;
        facet f;
        *level = LEVEL;
        if (begin >= p->T || re * re + im * im <= LEVEL * LEVEL) continue;
        f = facet_of(p, s, row);
        for (int i = 0; i < LFO_FACETS; i++) {
          lfo_real y = (turn(&f, i), facet_value(&f, s->V_old));
          if (y > s->rest * LEVEL) s->rest = y / LEVEL;
          if (y > *level && y > LEVEL * (1 + LFO_RAISED * p->tolerance)) *level = y; /* rounding alone does not add up */
        }
      }
    }
  for (int i = s->active - 1; i >= 0; i--)
    if (s->member[i] >= stage_rows(p)) {
      s->again[again] = s->member[i];
      s->seen[again++] = s->lambda[i]; /* lent until the first sweep */
      drop(p, s, i, 0);
    }
  while (again--) {
    lfo_real length, rho2;
    if (facet_of(p, s, s->again[again]).begin >= p->T) continue;
    gradient(p, s, s->again[again]);
    length = dot(s->row, s->row, p->r);
    rho2 = split(p, s);
    if (rho2 > 100 * p->dependent * p->dependent * length)
      append(p, s, (lfo_real)LFO_SQRT(rho2), s->again[again], 1, s->seen[again]);
  }
}

/* Shorten a part of the way from y to y + change, so that it ends within a bound that y keeps. */
static void shorten(lfo_real *part, lfo_real y, lfo_real change, lfo_real bound) {
  lfo_real room = bound > y ? bound - y : 0;
  if (change * *part > room) *part = room / change;
}

/* The largest part of the way from the rest of the last plan to s->control that keeps all rows of controls. A plan that
   solves the step may exceed them by rounding; where the state is far away, rounding can be large. */
static lfo_real part_of_way(const lfo_model *p, lfo_memory *s, const lfo_real *x, int solved) {
  int m = p->m, k = p->inner, moved = !solved;
  lfo_real slack = solved ? LFO_RAISED * p->tolerance : 0;
  lfo_real part = 1, state[2][LFO_STATES], next[LFO_STATES];
  const lfo_real *plans[2] = {s->old, s->control};
  for (int i = 0; i < k; i++) state[0][i] = state[1][i] = x[p->inner_state[i]];
  for (int t = 0; t < p->T; t++) {
    for (int f = 0; f < p->families; f++) {
      int bound = f * p->columns + p->column[t], j = p->of_controls[f] - 1;
      lfo_real y[2];
      for (int i = 0; i < 2; i++) y[i] = dot(p->D + f * m, plans[i] + t * m, m) + dot(p->inner_C + f * k, state[i], k);
      if (j == -1 || (p->upper[bound] >= NONE && p->lower[bound] <= -NONE)) continue;
      if (j >= 0) { /* first into the bounds of a control, so that these do not stop the way */
        lfo_real inside = y[1] > p->upper[bound] ? p->upper[bound] : y[1] < p->lower[bound] ? p->lower[bound] : y[1];
        moved |= absolute(inside - y[1]) > 4 * p->tolerance * p->size[f];
        s->control[t * m + j] += (inside - y[1]) / p->D[f * m + j];
        y[1] = inside;
      }
      if (p->limit_up[bound] >= NONE) shorten(&part, y[0], y[1] - y[0], p->upper[bound] + slack * p->size[f]);
      if (p->limit_low[bound] >= NONE) shorten(&part, -y[0], y[0] - y[1], slack * p->size[f] - p->lower[bound]);
    }
    for (int i = 0; i < 2; i++) {
      for (int l = 0; l < k; l++)
        next[l] = p->d[p->column[t] * p->n + p->inner_state[l]] + dot(p->inner_A + l * k, state[i], k) +
                  dot(p->B + p->inner_state[l] * m, plans[i] + t * m, m);
      memcpy(state[i], next, BYTES(k));
    }
  }
  if (moved) all_windows(p, s, s->control, s->V);
  for (const lfo_windows *w = p->windows; w < p->windows + p->sets; w++)
    for (int cell = w->cell; cell < w->cell + w->slots * w->points; cell++) {
      int at = cell + w->cell + (cell - w->cell) / w->points * w->points;
      lfo_real re = s->V[at], im = s->V[at + w->points], bound = s->level[cell] + (solved ? p->tolerance : 0);
      facet f;
      if (re * re + im * im <= LEVEL * LEVEL) continue;
      f = facet_of(p, s, stage_rows(p) + cell * LFO_FACETS);
      if (bound < LEVEL * (1 + slack)) bound = LEVEL * (1 + slack);
      for (int i = 0; f.begin < p->T && i < LFO_FACETS; i++) {
        lfo_real old = (turn(&f, i), facet_value(&f, s->V_old));
        shorten(&part, old, facet_value(&f, s->V) - old, bound);
      }
    }
  return part;
}

/* Go from the rest of the last plan towards the point where the step ended, as far as all rows of controls are kept: they
   are convex. Return whether this is the whole way. */
static int go_part_of_way(const lfo_model *p, lfo_memory *s, const lfo_real *x0, int solved) {
  int T = p->T, n = p->n, m = p->m;
  lfo_real x[LFO_STATES], next[LFO_STATES], part = part_of_way(p, s, x0, solved);
  if (solved && part >= 1) return 1;
  for (int i = 0; i < T * m; i++) {
    lfo_real change = s->control[i] - s->old[i];
    s->control[i] = s->old[i] + (change - change == 0 && part - part == 0 ? part * change : 0);
  }
  memcpy(x, x0, BYTES(n));
  for (int t = 0; t < T; t++) { /* its v, for lfo_plan */
    lfo_real *v = s->plan + t * m;
    for (int j = 0; j < m; j++) v[j] = s->control[t * m + j] - dot(p->K + j * n, x, n);
    for (int i = 0; i < n; i++)
      next[i] = p->d[p->column[t] * n + i] + dot(p->A + i * n, x, n) + dot(p->B + i * m, v, m);
    memcpy(x, next, BYTES(n));
  }
  return part >= 1;
}

void lfo_go_on(const lfo_model *p, lfo_memory *s, lfo_real *u) {
  memcpy(s->control, s->old, BYTES(p->T * p->m));
  memcpy(u, s->control, BYTES(p->m));
}

void lfo_apply(const lfo_model *p, lfo_memory *s, const lfo_real *u) {
  int m = p->m, rest = (p->T - 1) * m;
  memcpy(s->old, s->control + m, BYTES(rest));
  memcpy(s->old + rest, s->control + rest, BYTES(m)); /* the last control is held */
  for (int i = 0; i < p->sets; i++) {
    const lfo_windows *w = p->windows + i;
    int both = 2 * w->points, first = s->first[i], ring = w->slots - 1;
    for (int slot = 0; slot < ring; slot++) {
      int j = -begin_of(p, s, w, slot);
      if (j >= 0 && j < w->length) add(s->sums + 2 * w->cell + slot * both, u[w->component], w->wave + j * both, both);
    }
    if (--s->begin[i] > -w->length) continue;
    memset(s->sums + 2 * w->cell + first * both, 0, BYTES(both)); /* this window is over */
    s->first[i] = (first + 1) % ring;
    s->begin[i] += w->hop;
  }
}

int lfo_step(const lfo_model *p, lfo_memory *s, const lfo_real *x, lfo_real *u, lfo_real *states) {
  int T = p->T, m = p->m, status = LFO_LIMIT, corrections = 0, finite = 1;
  candidate queue[LFO_QUEUE];
  s->changes = s->sweeps = s->stuck = 0;
  for (int i = 0; i < p->p - 1; i++) finite &= x[i] - x[i] == 0;
  if (!finite && p->sets) lfo_go_on(p, s, u);
  if (!finite) return LFO_INFEASIBLE; /* nothing is changed */
  if (s->plans > 0) memcpy(s->before, s->plan, BYTES(T * m));
  memcpy(s->base, p->W + (p->p - 1) * T * m, BYTES(T * m));
  for (int j = 0; j < p->p - 1; j++) add(s->base, x[j], p->W + j * T * m, T * m);
  if (p->sets) begin_windows(p, s);
  from_multipliers(p, s);
  while (s->changes <= p->most_changes && status == LFO_LIMIT) {
    int count = sweep(p, s, x, queue, states), rounding = 0;
    lfo_real worst = 0;
    if (s->sweeps == 1 && !(s->worth >= 0)) { /* the multipliers of the step before are worse than none */
      memset(s->flag, 0, (size_t)lfo_rows(p));
      memset(s->xi, 0, BYTES(p->r));
      s->active = 0;
      continue;
    }
    for (int k = 0; k < s->active; k++) {
      lfo_real e = absolute(s->e[k]) / size_of(p, s->member[k]);
      worst = e > worst ? e : worst;
    }
    if (worst > p->tolerance / 4 && corrections++ < 3) {
      correct(p, s);
      continue;
    }
    corrections = 0;
    for (int i = 0; i < count && status == LFO_LIMIT && s->changes <= p->most_changes; i++) {
      int entered = relaxed_run(p, s, queue + i) ? ENTERED : enter(p, s, queue + i);
      rounding += entered == ROUNDING;
      if (entered == STUCK) status = LFO_INFEASIBLE;
    }
    if (rounding == count) status = LFO_SOLVED;
  }
  for (int i = 0; p->sets && i < T * m; i++) finite &= s->control[i] - s->control[i] == 0;
  if (!finite) { /* sums have overflowed */
    memset(s->flag, 0, (size_t)lfo_rows(p));
    s->active = 0;
    status = LFO_INFEASIBLE;
  }
  if (p->sets) {
    if (!go_part_of_way(p, s, x, status == LFO_SOLVED) && status == LFO_SOLVED) status = LFO_LIMIT;
    memcpy(u, s->control, BYTES(m));
    return status;
  }
  if (status != LFO_SOLVED && s->plans > 0) { /* the plan of the step before goes on, with its feedback */
    memcpy(s->plan, s->before + m, BYTES((T - 1) * m));
    memcpy(s->plan + (T - 1) * m, s->before + (T - 1) * m, BYTES(m));
  }
  if (status == LFO_SOLVED) s->plans = 1;
  for (int j = 0; j < m; j++) u[j] = s->plan[j] + dot(p->K + j * p->n, x, p->n);
  return status;
}
