/* A dual active-set method in few unknowns (Goldfarb and Idnani 1983), from the multipliers of the step before.

   The gradients of the rows are never stored: y comes from a sweep forward through the stable loop, a gradient and
   sums of multipliers times gradients from a sweep backward. A soft row is one whose multiplier has a limit, its
   price. Multipliers within their limits stay so whatever is measured: every step begins with those of the last. */
#include "kernel.h"
#include <math.h>
#include <string.h>

#define NONE ((lfo_real)LFO_NONE)
#define BYTES(count) (sizeof(lfo_real) * (size_t)(count))

enum { ENTERED, ROUNDING, STUCK };

typedef struct { /* the worst row of a run of violated rows of one family */
  int row, family, time;
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

int lfo_reals(const lfo_model *p) {
  int r = p->r, T = p->T, m = p->m, k = p->most_active;
#define LENGTH(name, length) +(length)
  return 0 LFO_ARRAYS(LENGTH);
}

int lfo_rows(const lfo_model *p) { return p->families * (p->T + 1); }

void lfo_begin(const lfo_model *p, lfo_memory *s, lfo_real *reals, int *members, signed char *flags) {
  int r = p->r, T = p->T, m = p->m, k = p->most_active;
  memset(s, 0, sizeof *s);
#define PLACE(name, length) s->name = reals, reals += length;
  LFO_ARRAYS(PLACE)
  s->member = members;
  s->flag = flags;
  memset(flags, 0, (size_t)lfo_rows(p));
}

/* Where the bounds and limits of a row are. */
static int bound_of(const lfo_model *p, int row) {
  return row / (p->T + 1) * p->columns + p->column[row % (p->T + 1)];
}

static lfo_real limit_of(const lfo_model *p, int row, int side) {
  return (side > 0 ? p->limit_up : p->limit_low)[bound_of(p, row)];
}

static lfo_real size_of(const lfo_model *p, int row) { return p->size[row / (p->T + 1)]; }

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
        run->family = f;
        run->time = t;
        run->y = y;
        run->violation = violation / p->size[f];
      }
    }
    if (t == T) break;
    for (int i = 0; i < n; i++) next[i] = d[i] + dot(p->A + i * n, x, n) + dot(p->B + i * m, v, m);
    memcpy(x, next, BYTES(n));
  }
  for (int f = 0; f < p->families; f++) count = queued(queue, count, runs + f);
  return count;
}

/* The gradient of a row: its response E, from its time back, against the columns of W. */
static void gradient(const lfo_model *p, lfo_memory *s, int f, int t) {
  int T = p->T, m = p->m, used = t < T ? t + 1 : T;
  const lfo_real *response = p->E + (f * (T + 1) + T - t) * m;
  for (int j = 0; j < p->r; j++) s->row[j] = dot(response, p->W + (p->p + j) * T * m, used * m);
}

/* The multiplier of a row with its sign: above zero at the upper bound. */
static lfo_real multiplier(const lfo_model *p, const lfo_memory *s, int row) {
  int flag = s->flag[row];
  if (flag == 2 || flag == -2) return s->lambda[position(s, row)];
  return flag ? (lfo_real)flag * limit_of(p, row, flag) : 0;
}

void lfo_multipliers(const lfo_model *p, const lfo_memory *s, lfo_real *out) {
  for (int row = 0; row < lfo_rows(p); row++) out[row] = multiplier(p, s, row);
}

/* xi = -(multipliers times gradients), by a sweep backward. */
static void from_multipliers(const lfo_model *p, lfo_memory *s) {
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
    }
    for (int f = 0; f < p->families; f++) {
      int row = f * (T + 1) + t;
      lfo_real lambda;
      if (!s->flag[row]) continue;
      lambda = multiplier(p, s, row);
      add(q, lambda, p->C + f * n, n);
      if (t < T) add(g, lambda, p->D + f * m, m);
    }
  }
  for (int j = 0; j < p->r; j++) s->xi[j] = -dot(s->g, p->W + (p->p + j) * T * m, T * m);
}

/* Split a gradient: z is its part outside of the span of the active ones, d its coefficients in Q. Return |z|^2.
   Gram-Schmidt twice is orthogonal to rounding. */
static lfo_real split(const lfo_model *p, lfo_memory *s) {
  int r = p->r, k = s->active;
  memcpy(s->z, s->row, BYTES(r));
  memset(s->d, 0, BYTES(k));
  for (int pass = 0; pass < 2; pass++)
    for (int i = 0; i < k; i++) {
      lfo_real part = dot(s->Q + i * r, s->z, r);
      s->d[i] += part;
      add(s->z, -part, s->Q + i * r, r);
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
  int r = p->r, at = bound_of(p, c->row), flag = s->flag[c->row], side, rest = 0;
  lfo_real y = c->y, bound, limit, lambda, length, sigma, moved = 0, allowed = p->tolerance * p->size[c->family];
  gradient(p, s, c->family, c->time);
  for (int j = 0; j < r; j++) s->z[j] = s->xi[j] - s->seen[j];
  y += dot(s->row, s->z, r); /* since the sweep */
  side = flag ? flag : y > p->upper[at] ? 1 : -1;
  limit = limit_of(p, c->row, side);
  bound = side > 0 ? p->upper[at] : p->lower[at];
  sigma = flag ? (lfo_real)-flag : (lfo_real)side;
  if (sigma * (y - bound) <= allowed) return ENTERED;
  lambda = flag ? (lfo_real)flag * limit : 0;
  length = dot(s->row, s->row, r);
  for (;;) {
    lfo_real rho2 = split(p, s), full = NONE, step;
    int leaving, independent = rho2 > p->dependent * p->dependent * length && s->active < p->most_active;
    if (++s->changes > p->most_changes) return ENTERED;
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
}

/* Let a whole run of soft rows exceed their bounds, if all multipliers at their limits are an ascent. Return whether. */
static int relaxed_run(const lfo_model *p, lfo_memory *s, const candidate *c) {
  int f = c->family, T = p->T, m = p->m, r = p->r, rest = 0, first = f * (T + 1);
  lfo_real step = 1, worth = c->worth, sigma;
  if (c->end - c->begin < LFO_RUN || (c->state != 1 && c->state != -1)) return 0;
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

int lfo_step(const lfo_model *p, lfo_memory *s, const lfo_real *x, lfo_real *u, lfo_real *states) {
  int T = p->T, m = p->m, status = LFO_LIMIT, corrections = 0, finite = 1;
  candidate queue[LFO_QUEUE];
  s->changes = s->sweeps = s->stuck = 0;
  for (int i = 0; i < p->p - 1; i++) finite &= x[i] - x[i] == 0;
  if (!finite) return LFO_INFEASIBLE; /* nothing is changed */
  if (s->plans > 0) memcpy(s->before, s->plan, BYTES(T * m));
  memcpy(s->base, p->W + (p->p - 1) * T * m, BYTES(T * m));
  for (int j = 0; j < p->p - 1; j++) add(s->base, x[j], p->W + j * T * m, T * m);
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
    for (int i = 0; i < count && status == LFO_LIMIT; i++) {
      int entered = relaxed_run(p, s, queue + i) ? ENTERED : enter(p, s, queue + i);
      rounding += entered == ROUNDING;
      if (entered == STUCK) status = LFO_INFEASIBLE;
    }
    if (rounding == count) status = LFO_SOLVED;
  }
  if (status != LFO_SOLVED && s->plans > 0) { /* the plan of the step before goes on, with its feedback */
    memcpy(s->plan, s->before + m, BYTES((T - 1) * m));
    memcpy(s->plan + (T - 1) * m, s->before + (T - 1) * m, BYTES(m));
  }
  if (status == LFO_SOLVED) s->plans = 1;
  for (int j = 0; j < m; j++) u[j] = s->plan[j] + dot(p->K + j * p->n, x, p->n);
  return status;
}
