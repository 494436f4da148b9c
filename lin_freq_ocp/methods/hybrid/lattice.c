/* The recursions of angle_lattice.py: the least L_r of the pulse trains whose angles are multiples of h.

   V(c, l, i, a) is the cost to go from angle i h with c switches done, at the level lowest + l, and with
   n = a - half + centre_i, the integral of the level from there to pi/2 in units of h times the step. A switch at i
   holds its level for hold_{c + 1} steps. Tables have the moments of R over 1 and over hold_c steps from i on. */
#include <math.h>
#include <stdint.h>

typedef struct {
  int count, switches, levels, lowest, half;       /* N, m, number of levels, 2 half + 1 integers */
  const int64_t *centre, *hold;                    /* (N + 1); (m + 1): the least dwells */
  const int64_t *low, *high, *sign;                /* (m): where a switch may be; 1 up, -1 down, 0 either */
  const int64_t *first, *last, *start;             /* (m + 1): the i with c switches done; (m + 1, levels): row or -1 */
  const double *moments;                           /* (m + 2, 3, N + 1): over one step; over hold_c */
  double h, step;
} lfo_lattice;

/* The place of the values (2 half + 1) of a state in V, or -1 where there is none. */
static int64_t place(const lfo_lattice *p, int c, int l, int64_t i) {
  if (l < 0 || l >= p->levels || i < p->first[c] || i > p->last[c] || p->start[c * p->levels + l] < 0) return -1;
  return (p->start[c * p->levels + l] + i - p->first[c]) * (2 * p->half + 1);
}

static void least_of(double *restrict now, const double *restrict other, const double *restrict cost, int count) {
#pragma omp simd
  for (int a = 0; a < count; a++) now[a] = cost[a] + other[a] < now[a] ? cost[a] + other[a] : now[a];
}

/* Hold the level l for `steps` between the states at `at` and `far`: the least of both ends into V there or, forth, of
   both starts into W here; return the least cost of a whole train. */
static double hold(const lfo_lattice *p, double *V, double *W, double *restrict cost, int forth, int64_t at,
                   int64_t far, int i, int64_t steps, int l, const double *moments) {
  int width = 2 * p->half + 1, stride = p->count + 1, level = p->lowest + l;
  int64_t shift = p->centre[i] - level * steps - p->centre[i + steps], base = p->centre[i] - p->half;
  int from = shift < 0 ? (shift < -width ? width : (int)-shift) : 0;
  int to = shift > 0 ? (shift > width ? 0 : width - (int)shift) : width;
  double t = p->h * (double)steps, q = p->h * p->step, v = p->step * level, least = INFINITY;
  double a2 = q * q * t, a1 = -q * (v * t * t - 2 * moments[i]);
  double a0 = v * v * t * t * t / 3 - 2 * v * moments[stride + i] + moments[2 * stride + i];
#pragma omp simd
  for (int a = from; a < to; a++) {
    double n = (double)(base + a);
    cost[a] = (a2 * n + a1) * n + a0;
  }
  if (from >= to) return least;
  if (!forth) {
    least_of(V + at + from, V + far + from + shift, cost + from, to - from);
    return least;
  }
  least_of(W + far + from + shift, W + at + from, cost + from, to - from);
  const double *before = W + at, *after = V + far + shift;
#pragma omp simd reduction(min : least)
  for (int a = from; a < to; a++) {
    double whole = before[a] + cost[a] + after[a];
    least = whole < least ? whole : least;
  }
  return least;
}

/* Fill V, the cost to go, from the end, then W, the cost to arrive, from the start, and least (m, 2, N + 1), that of
   the trains with switch c at i, up or down. All three are infinite before. `cost` has room for 2 half + 1 numbers. */
void lfo_lattice_run(const lfo_lattice *p, double *V, double *W, double *least, double *cost) {
  int N = p->count, m = p->switches, width = 2 * p->half + 1;
  for (int forth = 0; forth < 2; forth++)
    for (int k = 0; k <= N; k++)
      for (int j = 0; j <= m; j++)
        for (int l = 0; l < p->levels; l++) {
          int i = forth ? k : N - k, c = forth ? j : m - j;
          int64_t at = place(p, c, l, i), next = place(p, c, l, i + 1);
          if (at < 0) continue;
          if (forth && i == 0 && c == 0)
            for (int a = 0; a < width; a++) W[at + a] = 0;
          if (!forth && i == N && c == m) V[at + p->half] = 0;
          if (next >= 0) hold(p, V, W, cost, forth, at, next, i, 1, l, p->moments);
          for (int s = 1; s >= -1 && c < m && i >= p->low[c] && i <= p->high[c]; s -= 2) {
            int64_t far = p->sign[c] == -s ? -1 : place(p, c + 1, l + s, i + p->hold[c + 1]);
            if (far < 0) continue;
            const double *moments = p->moments + (c + 2) * 3 * (int64_t)(N + 1);
            double whole = hold(p, V, W, cost, forth, at, far, i, p->hold[c + 1], l + s, moments);
            double *here = least + ((int64_t)c * 2 + (s < 0)) * (N + 1) + i;
            *here = whole < *here ? whole : *here;
          }
        }
}
