/* The recursion of angle_lattice.py: the least L_r of the pulse trains whose angles are multiples of h.

   V(i, c, l, a) is the cost to go from angle i h with c switches done, at the level lowest + l, and with
   n = a - half + centre_i, the integral of the level from there to pi/2 in units of h times the step. A switch at i
   holds its level for hold_{c + 1} steps. Tables have the moments of R over 1 and over hold_c steps from i on. */
#include <math.h>
#include <stdint.h>
#include <string.h>

typedef struct {
  int count, switches, levels, lowest, half, ring; /* N, m, number of levels, 2 half + 1 integers, angles stored */
  const int64_t *centre, *hold;                    /* (N + 1); (m + 1): the least dwells */
  const int64_t *low, *high, *sign;                /* (m): where a switch may be; 1 up, -1 down, 0 either */
  const double *moments;                           /* (m + 2, 3, N + 1): over one step; over hold_c */
  double h, step;
} lfo_lattice;

/* Take the values of another angle over where they are better: at its level v for `steps`, `shift` along the window. */
static void reach(const lfo_lattice *p, double *restrict now, int8_t *restrict choice, const double *restrict other,
                  int i, int steps, int level, const double *moments, int8_t label) {
  int width = 2 * p->half + 1, stride = p->count + 1;
  int64_t shift = p->centre[i] - level * (int64_t)steps - p->centre[i + steps], base = p->centre[i] - p->half;
  int from = shift < 0 ? (shift < -width ? width : (int)-shift) : 0;
  int to = shift > 0 ? (shift > width ? 0 : width - (int)shift) : width;
  double t = p->h * steps, q = p->h * p->step, v = p->step * level;
  double a2 = q * q * t, a1 = -q * (v * t * t - 2 * moments[i]);
  double a0 = v * v * t * t * t / 3 - 2 * v * moments[stride + i] + moments[2 * stride + i];
#pragma omp simd
  for (int a = from; a < to; a++) {
    double n = (double)(base + a), cost = (a2 * n + a1) * n + a0 + other[a + shift];
    choice[a] = cost < now[a] ? label : choice[a];
    now[a] = cost < now[a] ? cost : now[a];
  }
}

/* Fill V (ring, m + 1, levels, 2 half + 1) and the choices (N + 1, the same): 0 stay, 1 up, 2 down. */
void lfo_lattice_run(const lfo_lattice *p, double *V, int8_t *choices) {
  int N = p->count, m = p->switches, L = p->levels, width = 2 * p->half + 1;
  int64_t plane = (int64_t)(m + 1) * L * width;
  for (int i = N; i >= 0; i--)
    for (int c = m; c >= 0; c--)
      for (int l = 0; l < L; l++) {
        int64_t at = ((int64_t)c * L + l) * width;
        double *now = V + (i % p->ring) * plane + at;
        int8_t *choice = choices + i * plane + at;
        int level = p->lowest + l;
        for (int a = 0; a < width; a++) now[a] = INFINITY;
        if ((c + level) % 2) continue; /* a switch changes the parity of the level */
        if ((c && i < p->low[c - 1]) || (c < m && i > p->high[c])) continue; /* too early or too late for c switches */
        memset(choice, 0, (size_t)width);
        if (i == N && c == m) now[p->half - p->centre[N]] = 0;
        if (i < N) reach(p, now, choice, V + ((i + 1) % p->ring) * plane + at, i, 1, level, p->moments, 0);
        if (c == m || i < p->low[c] || i > p->high[c] || i + p->hold[c + 1] > N) continue;
        for (int s = 1; s >= -1; s -= 2)
          if (l + s >= 0 && l + s < L && p->sign[c] != -s) {
            int steps = (int)p->hold[c + 1];
            const double *far = V + ((i + steps) % p->ring) * plane + ((c + 1) * (int64_t)L + l + s) * width;
            reach(p, now, choice, far, i, steps, level + s, p->moments + (c + 2) * 3 * (int64_t)(N + 1), s > 0 ? 1 : 2);
          }
      }
}
