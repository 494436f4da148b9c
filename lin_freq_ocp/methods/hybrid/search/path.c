/* The embedding of path relaxations (program/hybrid/path_relaxation.py): a node of a search takes some ten steps.

       minimise cost'w   subject to   C w = b,   G w + s = 0,   s in K.

   With multipliers p and z, and homogeneous in tau,

       r_w = C'p + G'z + cost tau,   r_p = C w - b tau,   r_s = G w + s,   r_tau = kappa + cost'w + b'p.

   Arrays have the E edges, by time, as their last index. An edge has W = k + 2 variables (v, delta, epsilon), rows C of
   its two vertices, and signals on which the rows over all times act. With Phi = G'W^-2 G of an edge, L L' = Phi and
   X = [C; signals] L^-T, sums of X X' make the matrix of the multipliers: a band of the vertices, which are numbered by
   time, bordered by the rows over all times. The cone of an edge is an orthant of linear rows, the first 2k of which are
   the box |v| <= delta, and a second-order cone whose first two rows are -(delta + epsilon) and delta - epsilon; no row
   but these has epsilon. Its algebra is that of base/cones.py. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "../../dense.h"

#define PIVOT 1e-14          /* least pivot relative to the diagonal entry before elimination: below is rounding */
#define LEAST_SQUARE 1e-300  /* of s'Js: rounding may make it zero at the boundary of a cone */
#define FRACTION 0.99        /* of the way to the boundary */
#define INTERIOR 1e-2        /* distance of the first point to the boundary, of its size, below which it is moved */
#define MOVED 0.1            /* of the size, the distance to which it is moved; at least 1 */
#define MOST_STEPS 60
#define SHORTEST_STEP 1e-5   /* a step that makes no progress */
#define VANISHED_TAU 1e-2    /* tau, relative to kappa, below which a ray is tried; the search verifies it */
#define RAY 1e-7             /* residual of a ray relative to -b'p */
#define CLEAR_RESIDUAL 1e-3  /* of a point accurate enough to decide that a node must be split */
#define BOUNDED_FROM 4       /* steps: the bounds of points before prove nothing of use */
#define SWEEPS 2             /* of minimisation by coordinates; one is exact if the Hessian is diagonal */

enum { OPTIMAL, DECIDED, INFEASIBLE, STALLED };
enum { TAU, BOUND, PROVEN };

typedef struct {
  int edges, width;            /* E, W */
  int rows, signals;           /* of C and over all times */
  int equations, coupled;      /* entries of b; of these, rows over all times */
  int times, modes;            /* T + 1 */
  int linear, conic;           /* rows of the orthant and of the second-order cone */
  int shares, images;          /* rows of regions and images; upper rows of images, followed by as many lower ones */
  const double *C;             /* (rows + signals, W, E) */
  const int64_t *place;        /* (rows, E): the equations of C, -1 where there is none */
  const int64_t *time, *leaves, *enters; /* (E): of an edge, and the modes of its vertices */
  const double *over;          /* (coupled, times, signals) */
  const double *b, *cost, *G;  /* (equations), (W, E), (linear + conic, W, E) */
  const double *share;         /* (shares, E): 1 / size of a row, zero where it is not present */
} lfo_path;

typedef struct { /* what steps share; sizes as in begin */
  double *L, *X, *S, *border, *rest, *moments;
  double *scale, *eta, *lam, *square, *scaled, *aim, *second, *of_z, *of_s;
  double *r_w, *r_p, *r_s, *dw, *dp, *dz, *ds, *constant_w, *constant_p;
  double *s, *edge, *more, *slope, *cone, *value, *sums;
  int *last, band;
} work;

static double larger(double a, double b) { return a > b ? a : b; }
static double smaller(double a, double b) { return a < b ? a : b; }

static double size_of(const double *v, int count) {
  double most = 0;
#pragma omp simd reduction(max : most)
  for (int i = 0; i < count; i++) most = larger(most, fabs(v[i]));
  return most;
}

/* out += sign a b, entry by entry */
static void add_products(double *restrict out, double sign, const double *restrict a, const double *restrict b, int count) {
#pragma omp simd
  for (int i = 0; i < count; i++) out[i] += sign * a[i] * b[i];
}

/* ---- The algebra of the cones: rows of E members each, `orthant` of them >= 0, and a second-order cone of `conic`. */

/* |(v_1, ...)|^2 of the members */
static void tail_products(const lfo_path *p, const double *a, const double *b, double *out) {
  int E = p->edges;
  memset(out, 0, sizeof(double) * (size_t)E);
  for (int i = p->linear + 1; i < p->linear + p->conic; i++) add_products(out, 1.0, a + i * E, b + i * E, E);
}

static void determinants(const lfo_path *p, const double *v, double *out) {
  int E = p->edges;
  const double *head = v + p->linear * E;
  tail_products(p, v, v, out);
#pragma omp simd
  for (int e = 0; e < E; e++) {
    double size = sqrt(out[e]);
    out[e] = larger((head[e] - size) * (head[e] + size), LEAST_SQUARE);
  }
}

/* The least spectral value of all members. */
static double margin(const lfo_path *p, const double *v, work *k) {
  int E = p->edges;
  double least = INFINITY;
  for (int i = 0; i < p->linear * E; i++) least = smaller(least, v[i]);
  tail_products(p, v, v, k->value);
  for (int e = 0; e < E; e++) least = smaller(least, v[p->linear * E + e] - sqrt(k->value[e]));
  return least;
}

static void product(const lfo_path *p, const double *a, const double *b, double *out) {
  int E = p->edges, n = p->linear * E;
  double *head = out + n;
#pragma omp simd
  for (int i = 0; i < n; i++) out[i] = a[i] * b[i];
  tail_products(p, a, b, head);
  add_products(head, 1.0, a + n, b + n, E);
  for (int i = p->linear + 1; i < p->linear + p->conic; i++)
#pragma omp simd
    for (int e = 0; e < E; e++) out[i * E + e] = a[n + e] * b[i * E + e] + b[n + e] * a[i * E + e];
}

/* The v with a o v = d. */
static void quotient(const lfo_path *p, const double *a, const double *d, double *out, work *k) {
  int E = p->edges, n = p->linear * E;
  double *along = k->value, *square = k->sums;
#pragma omp simd
  for (int i = 0; i < n; i++) out[i] = d[i] / a[i];
  tail_products(p, a, d, along);
  determinants(p, a, square);
#pragma omp simd
  for (int e = 0; e < E; e++) out[n + e] = (a[n + e] * d[n + e] - along[e]) / square[e];
  for (int i = p->linear + 1; i < p->linear + p->conic; i++)
#pragma omp simd
    for (int e = 0; e < E; e++) out[i * E + e] = (d[i * E + e] - a[i * E + e] * out[n + e]) / a[n + e];
}

/* (w, eta) of W^-1 for interior points s and z. */
static void compute_scaling(const lfo_path *p, const double *s, const double *z, work *k) {
  int E = p->edges, n = p->linear * E;
  double *w = k->scale, *of_s = k->value, *of_z = k->sums, *along = k->cone;
#pragma omp simd
  for (int i = 0; i < n; i++) w[i] = sqrt(z[i] / s[i]);
  determinants(p, z, of_z);
  determinants(p, s, of_s);
  tail_products(p, s, z, along);
#pragma omp simd
  for (int e = 0; e < E; e++) {
    double of_both;
    of_s[e] = sqrt(of_s[e]), of_z[e] = sqrt(of_z[e]);
    of_both = (along[e] + s[n + e] * z[n + e]) / (of_s[e] * of_z[e]);
    along[e] = 2 * sqrt(larger((1 + of_both) / 2, 1.0)); /* 2 gamma */
    k->eta[e] = sqrt(of_z[e] / of_s[e]);
  }
  for (int i = p->linear + 1; i < p->linear + p->conic; i++)
#pragma omp simd
    for (int e = 0; e < E; e++) {
      int r = i * E + e;
      w[r] = z[r] / (of_z[e] * along[e]) - s[r] / (of_s[e] * along[e]);
    }
  tail_products(p, w, w, w + n);
#pragma omp simd
  for (int e = 0; e < E; e++) w[n + e] = sqrt(1 + w[n + e]);
}

/* W^-1 v */
static void apply_scaling(const lfo_path *p, const work *k, const double *v, double *out) {
  int E = p->edges, n = p->linear * E;
  const double *w = k->scale;
  double *move = k->value;
#pragma omp simd
  for (int i = 0; i < n; i++) out[i] = w[i] * v[i];
  tail_products(p, w, v, move);
#pragma omp simd
  for (int e = 0; e < E; e++) {
    out[n + e] = k->eta[e] * (w[n + e] * v[n + e] + move[e]);
    move[e] = v[n + e] + move[e] / (1 + w[n + e]);
  }
  for (int i = p->linear + 1; i < p->linear + p->conic; i++)
#pragma omp simd
    for (int e = 0; e < E; e++) out[i * E + e] = k->eta[e] * (v[i * E + e] + w[i * E + e] * move[e]);
}

/* 1/a for the longest step a from lam along a direction that stays in the cone; zero if any step does. */
static double steepest(const lfo_path *p, const work *k, const double *direction) {
  int E = p->edges, n = p->linear * E;
  const double *lam = k->lam;
  double slope = 0, *along = k->value, *size = k->sums, *across = k->cone;
#pragma omp simd reduction(max : slope)
  for (int i = 0; i < n; i++) slope = larger(slope, -direction[i] / lam[i]);
  determinants(p, lam, size);
  tail_products(p, lam, direction, along);
#pragma omp simd
  for (int e = 0; e < E; e++) {
    size[e] = sqrt(size[e]);
    along[e] = (lam[n + e] * direction[n + e] - along[e]) / size[e];
    across[e] = 0;
  }
  for (int i = p->linear + 1; i < p->linear + p->conic; i++)
#pragma omp simd
    for (int e = 0; e < E; e++) {
      double move = (along[e] + direction[n + e]) / (lam[n + e] / size[e] + 1) / size[e];
      double part = direction[i * E + e] - move * lam[i * E + e];
      across[e] += part * part;
    }
#pragma omp simd reduction(max : slope)
  for (int e = 0; e < E; e++) slope = larger(slope, (sqrt(across[e]) - along[e]) / size[e]);
  return slope;
}

/* ---- The linear system of a step. */

/* out += G w */
static void add_cone_rows(const lfo_path *p, const double *w, double *out) {
  int E = p->edges, W = p->width, k = W - 2;
  for (int i = 0; i < k; i++)
#pragma omp simd
    for (int e = 0; e < E; e++) {
      out[i * E + e] += w[i * E + e] - w[k * E + e];
      out[(k + i) * E + e] -= w[i * E + e] + w[k * E + e];
    }
  for (int i = 2 * k; i < p->linear + p->conic; i++) {
    for (int m = 0; m <= k; m++) add_products(out + i * E, 1.0, p->G + (i * W + m) * E, w + m * E, E);
    if (i == p->linear || i == p->linear + 1) add(out + i * E, -1.0, w + (k + 1) * E, E);
  }
}

/* out += sign G'z */
static void add_cone_adjoint(const lfo_path *p, double sign, const double *z, double *out) {
  int E = p->edges, W = p->width, k = W - 2;
  for (int i = 0; i < k; i++)
#pragma omp simd
    for (int e = 0; e < E; e++) {
      double up = z[i * E + e], low = z[(k + i) * E + e];
      out[i * E + e] += sign * (up - low);
      out[k * E + e] -= sign * (up + low);
    }
  for (int i = 2 * k; i < p->linear + p->conic; i++) {
    for (int m = 0; m <= k; m++) add_products(out + m * E, sign, p->G + (i * W + m) * E, z + i * E, E);
    if (i == p->linear || i == p->linear + 1) add(out + (k + 1) * E, -sign, z + i * E, E);
  }
}

/* Add the rows of vertices and over all times, with these coefficients, applied to w. */
static void add_rows(const lfo_path *p, work *k, const double *rows, const double *w, double *out) {
  int E = p->edges, a = p->signals;
  double *value = k->value, *sums = k->sums;
  memset(sums, 0, sizeof(double) * (size_t)(p->times * a));
  for (int r = 0; r < p->rows + a; r++) {
    memset(value, 0, sizeof(double) * (size_t)E);
    for (int m = 0; m < p->width; m++) add_products(value, 1.0, rows + (r * p->width + m) * E, w + m * E, E);
    for (int e = 0; e < E; e++) {
      if (r >= p->rows) sums[p->time[e] * a + r - p->rows] += value[e];
      else if (p->place[r * E + e] >= 0) out[p->place[r * E + e]] += value[e];
    }
  }
  for (int r = 0; r < p->coupled; r++)
    out[p->equations - p->coupled + r] += dot(p->over + r * p->times * a, sums, p->times * a);
}

/* Add sign times the adjoint of add_rows. */
static void add_adjoint(const lfo_path *p, work *k, const double *rows, double sign, const double *v, double *out) {
  int E = p->edges, a = p->signals;
  double *price = k->value, *pulled = k->sums;
  memset(pulled, 0, sizeof(double) * (size_t)(p->times * a));
  for (int r = 0; r < p->coupled; r++)
    add(pulled, v[p->equations - p->coupled + r], p->over + r * p->times * a, p->times * a);
  for (int r = 0; r < p->rows + a; r++) {
    for (int e = 0; e < E; e++) {
      if (r >= p->rows) price[e] = pulled[p->time[e] * a + r - p->rows];
      else price[e] = p->place[r * E + e] >= 0 ? v[p->place[r * E + e]] : 0.0;
    }
    for (int m = 0; m < p->width; m++) add_products(out + m * E, sign, rows + (r * p->width + m) * E, price, E);
  }
}

/* The lower triangles of Phi = G'W^-2 G in L. */
static void edge_hessians(const lfo_path *p, work *k) {
  int E = p->edges, W = p->width, K = W - 2;
  double *weight = k->value, *q = k->more, *last = k->L + (K * W + K) * E;
  memset(k->L, 0, sizeof(double) * (size_t)(W * W * E));
  memset(q, 0, sizeof(double) * (size_t)(W * E));
  for (int i = 0; i < K; i++) { /* the box */
    double *own = k->L + (i * W + i) * E, *cross = k->L + (K * W + i) * E;
    const double *up = k->scale + i * E, *low = k->scale + (K + i) * E;
#pragma omp simd
    for (int e = 0; e < E; e++) {
      double above = up[e] * up[e], below = low[e] * low[e];
      own[e] += above + below;
      cross[e] += below - above;
      last[e] += above + below;
    }
  }
  for (int i = 2 * K; i < p->linear + p->conic; i++) {
    int head = i == p->linear, heads = head || i == p->linear + 1;
    const double *row = p->G + i * W * E, *w = k->scale + i * E;
#pragma omp simd
    for (int e = 0; e < E; e++)
      weight[e] = i < p->linear ? w[e] * w[e] : head ? -k->eta[e] * k->eta[e] : k->eta[e] * k->eta[e];
    for (int a = 0; a < W - 1 + heads; a++) {
      if (i >= p->linear) add_products(q + a * E, 1.0, w, row + a * E, E);
      for (int b = 0; b <= a; b++) {
        double *restrict out = k->L + (a * W + b) * E;
        const double *restrict of_a = row + a * E, *restrict of_b = row + b * E;
#pragma omp simd
        for (int e = 0; e < E; e++) out[e] += weight[e] * of_a[e] * of_b[e];
      }
    }
  }
  for (int a = 0; a < W; a++)
    for (int b = 0; b <= a; b++) {
      double *restrict out = k->L + (a * W + b) * E;
#pragma omp simd
      for (int e = 0; e < E; e++) out[e] += 2 * q[a * E + e] * q[b * E + e] * k->eta[e] * k->eta[e];
    }
}

/* Replace Phi by its factors, and write X. */
static void factor_edges(const lfo_path *p, work *k) {
  int E = p->edges, W = p->width, count = p->rows + p->signals;
  double *L = k->L, *X = k->X, *least = k->value;
  memcpy(X, p->C, sizeof(double) * (size_t)(count * W * E));
  for (int j = 0; j < W; j++) {
    double *pivot = L + (j * W + j) * E;
#pragma omp simd
    for (int e = 0; e < E; e++) least[e] = PIVOT * pivot[e];
    for (int m = 0; m < j; m++) add_products(pivot, -1.0, L + (j * W + m) * E, L + (j * W + m) * E, E);
#pragma omp simd
    for (int e = 0; e < E; e++) pivot[e] = sqrt(larger(pivot[e], least[e]));
    for (int i = j + 1; i < W + count; i++) {
      double *row = i < W ? L + i * W * E : X + (i - W) * W * E, *restrict own = row + j * E;
      for (int m = 0; m < j; m++) add_products(own, -1.0, row + m * E, L + (j * W + m) * E, E);
#pragma omp simd
      for (int e = 0; e < E; e++) own[e] /= pivot[e];
    }
  }
}

/* The factors of the band, L' with row i from column i to last[i], and of the Schur complement of the border. */
static void factor_path(const lfo_path *p, work *k) {
  int E = p->edges, q = p->coupled, a = p->signals, vertices = p->equations - q, band = k->band, all = p->times * a;
  double *S = k->S, *value = k->value;
  memset(S, 0, sizeof(double) * (size_t)(vertices * band));
  memset(k->border, 0, sizeof(double) * (size_t)(vertices * q));
  memset(k->moments, 0, sizeof(double) * (size_t)(all * a));
  factor_edges(p, k);
  for (int r = 0; r < p->rows + a; r++)
    for (int c = 0; c <= r; c++) {
      memset(value, 0, sizeof(double) * (size_t)E);
      for (int m = 0; m < p->width; m++)
        add_products(value, 1.0, k->X + (r * p->width + m) * E, k->X + (c * p->width + m) * E, E);
      for (int e = 0; e < E; e++) {
        int64_t i = r < p->rows ? p->place[r * E + e] : 0, j = c < p->rows ? p->place[c * E + e] : 0, t = p->time[e];
        if (i < 0 || j < 0) continue;
        if (r < p->rows) S[(i < j ? i : j) * band + llabs(i - j)] += value[e];
        else if (c >= p->rows) k->moments[(t * a + r - p->rows) * a + c - p->rows] += value[e];
        else
          for (int row = 0; row < q; row++) k->border[j * q + row] += p->over[row * all + t * a + r - p->rows] * value[e];
      }
    }
  for (int i = 0; i < vertices; i++) value[i] = S[i * band]; /* the diagonal before elimination */
  for (int i = 0; i < vertices; i++) {
    double *row = S + i * band, scale;
    int after = k->last[i] - i;
    row[0] = value[i] > 0 ? sqrt(larger(row[0], PIVOT * value[i])) : 1.0;
    scale = 1 / row[0];
    for (int j = 1; j <= after; j++) row[j] *= scale;
    for (int c = 0; c < q; c++) k->border[i * q + c] *= scale;
    for (int j = 1; j <= after; j++) {
      add(S + (i + j) * band, -row[j], row + j, after - j + 1);
      add(k->border + (i + j) * q, -row[j], k->border + i * q, q);
    }
  }
  for (int r = 0; r < q; r++)
    for (int c = 0; c <= r; c++) {
      double sum = 0;
      for (int t = 0; t < p->times; t++)
        for (int i = 0; i < a; i++)
          for (int j = 0; j < a; j++)
            sum += p->over[r * all + t * a + i] * k->moments[(t * a + (i > j ? i : j)) * a + (i > j ? j : i)] *
                   p->over[c * all + t * a + j];
      for (int m = 0; m < vertices; m++) sum -= k->border[m * q + r] * k->border[m * q + c];
      k->rest[r * q + c] = sum;
    }
  cholesky(k->rest, q, PIVOT);
}

/* (w, v) with Phi w + C'v = of_w, C w = of_p, C with the rows over all times; w is of_w first. */
static void solve_path(const lfo_path *p, work *k, double *w, const double *of_p, double *v) {
  int E = p->edges, W = p->width, q = p->coupled, vertices = p->equations - q, band = k->band;
  const double *L = k->L;
  double *tail = v + vertices;
  for (int i = 0; i < W; i++) {
    for (int m = 0; m < i; m++) add_products(w + i * E, -1.0, L + (i * W + m) * E, w + m * E, E);
#pragma omp simd
    for (int e = 0; e < E; e++) w[i * E + e] /= L[(i * W + i) * E + e];
  }
  for (int i = 0; i < p->equations; i++) v[i] = -of_p[i];
  add_rows(p, k, k->X, w, v);
  for (int i = 0; i < vertices; i++) {
    const double *row = k->S + i * band;
    v[i] /= row[0];
    add(v + i + 1, -v[i], row + 1, k->last[i] - i);
    add(tail, -v[i], k->border + i * q, q);
  }
  for (int i = 0; i < q; i++) tail[i] = (tail[i] - dot(k->rest + i * q, tail, i)) / k->rest[i * q + i];
  for (int i = q - 1; i >= 0; i--) {
    tail[i] /= k->rest[i * q + i];
    add(tail, -tail[i], k->rest + i * q, i);
  }
  for (int i = 0; i < vertices; i++) v[i] -= dot(k->border + i * q, tail, q);
  for (int i = vertices - 1; i >= 0; i--) {
    const double *row = k->S + i * band;
    v[i] = (v[i] - dot(row + 1, v + i + 1, k->last[i] - i)) / row[0];
  }
  add_adjoint(p, k, k->X, -1.0, v, w);
  for (int i = W - 1; i >= 0; i--) {
    for (int m = i + 1; m < W; m++) add_products(w + i * E, -1.0, L + (m * W + i) * E, w + m * E, E);
#pragma omp simd
    for (int e = 0; e < E; e++) w[i * E + e] /= L[(i * W + i) * E + e];
  }
}

/* ---- The bound of multipliers: a shortest path. An edge with delta = 1 has the share (v, 1, epsilon), |v| <= 1, and
   the length

       phi = min over v of  slope'(v, 1) + |r(v)|^2 / 4,     slope = cost + C'p + (G'z of regions and images) of v and 1,

   r the rows of the cone beyond the first two. Its gradient at any point bounds it from below, as it is convex. */

/* The slopes of (p, z)/tau, (W, E); the last row, of epsilon, is that of a constant to be added to phi. */
static void path_slopes(const lfo_path *p, work *k, const double *v, const double *z, double tau) {
  int E = p->edges, W = p->width, first = p->linear - p->shares, n = p->images;
  double *slope = k->slope, *constant = slope + (W - 1) * E;
  for (int i = 0; i < W * E; i++) slope[i] = tau * p->cost[i];
  add_adjoint(p, k, p->C, 1.0, v, slope);
  memset(constant, 0, sizeof(double) * (size_t)E);
  for (int i = 0; i < p->shares; i++)
    for (int m = 0; m < W - 1; m++)
      for (int e = 0; e < E; e++)
        if (p->share[i * E + e] > 0) slope[m * E + e] += p->G[((first + i) * W + m) * E + e] * z[(first + i) * E + e];
  for (int d = 0; d < n; d++) { /* the part common to both bounds of an image counts as zero: the width of its box */
    int up = p->shares - 2 * n + d, low = p->shares - n + d;
    for (int e = 0; e < E; e++) {
      double of_up = p->share[up * E + e], of_low = p->share[low * E + e], common;
      if (!(of_up > 0 && of_low > 0)) continue;
      common = smaller(of_up * z[(first + up) * E + e], of_low * z[(first + low) * E + e]);
      constant[e] -= common * (p->G[((first + up) * W + W - 2) * E + e] / of_up +
                               p->G[((first + low) * W + W - 2) * E + e] / of_low);
    }
  }
  for (int i = 0; i < W * E; i++) slope[i] /= tau;
}

/* phi of the slopes, from the shares w on, in the last row of the slopes. */
static void path_lengths(const lfo_path *p, work *k, const double *w) {
  int E = p->edges, W = p->width, K = W - 2, rank = p->conic - 2;
  const double *slope = k->slope, *R = p->G + (p->linear + 2) * W * E;
  double *v = k->edge, *r = k->cone, *phi = k->slope + (K + 1) * E, *gradient = k->value, *curvature = k->sums;
  add(phi, 1.0, slope + K * E, E);
  for (int j = 0; j < K; j++)
    for (int e = 0; e < E; e++)
      v[j * E + e] = w[K * E + e] > 0 ? smaller(larger(w[j * E + e] / w[K * E + e], -1.0), 1.0) : 0.0;
  for (int i = 0; i < rank; i++) {
    memcpy(r + i * E, R + (i * W + K) * E, sizeof(double) * (size_t)E);
    for (int j = 0; j < K; j++) add_products(r + i * E, 1.0, R + (i * W + j) * E, v + j * E, E);
  }
  for (int sweep = 0; sweep <= SWEEPS; sweep++)
    for (int j = 0; j < K; j++) {
      memcpy(gradient, slope + j * E, sizeof(double) * (size_t)E);
      memset(curvature, 0, sizeof(double) * (size_t)E);
      for (int i = 0; i < rank; i++) {
        add_products(gradient, 0.5, R + (i * W + j) * E, r + i * E, E);
        add_products(curvature, 0.5, R + (i * W + j) * E, R + (i * W + j) * E, E);
      }
      if (sweep == SWEEPS) {
        for (int e = 0; e < E; e++)
          phi[e] += slope[j * E + e] * v[j * E + e] - gradient[e] * v[j * E + e] - fabs(gradient[e]);
        continue;
      }
      for (int e = 0; e < E; e++) { /* a step of more than 2 would cross the whole box */
        double step = fabs(gradient[e]) < 2 * curvature[e] ? gradient[e] / curvature[e] : 2.0 * copysign(gradient[e] != 0, gradient[e]);
        gradient[e] = smaller(larger(v[j * E + e] - step, -1.0), 1.0) - v[j * E + e];
      }
      add(v + j * E, 1.0, gradient, E);
      for (int i = 0; i < rank; i++) add_products(r + i * E, 1.0, R + (i * W + j) * E, gradient, E);
    }
  for (int i = 0; i < rank; i++) add_products(phi, 0.25, r + i * E, r + i * E, E);
}

/* The lower bound on the objective that (v, z)/tau prove. */
static double proven_bound(const lfo_path *p, work *k, const double *w, const double *v, const double *z, double tau) {
  int M = p->modes, count = (p->times + 1) * M;
  double *value = k->sums, least = INFINITY;
  const double *phi = k->slope + (p->width - 1) * p->edges;
  path_slopes(p, k, v, z, tau);
  path_lengths(p, k, w);
  for (int i = 0; i < count; i++) value[i] = i < count - M ? INFINITY : 0.0;
  for (int e = p->edges - 1; e >= 0; e--) {
    double *own = value + p->time[e] * M + p->leaves[e];
    *own = smaller(*own, phi[e] + value[(p->time[e] + 1) * M + p->enters[e]]);
  }
  for (int i = 0; i < M; i++) least = smaller(least, value[i]);
  return least - dot(p->b, v, p->equations) / tau;
}

/* ---- The iteration. */

typedef struct {
  double tau, kappa, cost, bound, of_primal, of_ray, mu, proven; /* cost and bound of (w, p)/tau; relative residuals */
} numbers;

static void measure(const lfo_path *p, work *k, const double *w, const double *v, const double *z, numbers *x) {
  int E = p->edges, signals = p->width * E, cones = (p->linear + p->conic) * E;
  double of_cost = dot(p->cost, w, signals), bound = -dot(p->b, v, p->equations), size;
  memset(k->r_w, 0, sizeof(double) * (size_t)signals);
  memset(k->r_p, 0, sizeof(double) * (size_t)p->equations);
  memcpy(k->r_s, k->s, sizeof(double) * (size_t)cones);
  add_rows(p, k, p->C, w, k->r_p);
  add_cone_rows(p, w, k->r_s);
  add_cone_adjoint(p, 1.0, z, k->r_w);
  add_adjoint(p, k, p->C, 1.0, v, k->r_w);
  x->of_ray = bound > 0 ? size_of(k->r_w, signals) / bound : INFINITY;
  add(k->r_w, x->tau, p->cost, signals);
  add(k->r_p, -x->tau, p->b, p->equations);
  x->cost = of_cost / x->tau, x->bound = bound / x->tau;
  size = larger(size_of(k->r_p, p->equations), size_of(k->r_s, cones));
  x->of_primal = size / (x->tau + size_of(w, signals));
  x->mu = (dot(k->s, z, cones) + x->tau * x->kappa) / ((p->linear + 1) * E + 1);
}

/* How the run ends, or -1. A node must be split if the bound misses the cost by less than `clear` times the distance to
   the cutoff. */
static int end_of_run(const numbers *x, double tolerance, double proven, double cutoff, double clear) {
  double gap = fabs(x->cost - x->bound), size = larger(1.0, smaller(fabs(x->cost), fabs(x->proven)));
  if (x->of_primal <= tolerance && gap <= tolerance * size && x->cost - x->proven <= proven * size) return OPTIMAL;
  if (x->tau < VANISHED_TAU * smaller(1.0, x->kappa) && x->of_ray <= RAY) return INFEASIBLE;
  if (x->proven > cutoff) return DECIDED;
  if (clear > 0 && cutoff < INFINITY && fabs(x->cost - x->proven) <= clear * (cutoff - x->cost) &&
      x->of_primal <= CLEAR_RESIDUAL)
    return DECIDED;
  return -1;
}

/* Move the point by predictor and corrector; return the length of the step. */
static double take_step(const lfo_path *p, work *k, double *w, double *v, double *z, numbers *x) {
  int E = p->edges, signals = p->width * E, cones = (p->linear + p->conic) * E;
  double tau = x->tau, kappa = x->kappa, sigma = 0, d_kappa = kappa * tau, a = 0;
  double r_tau = kappa + tau * (x->cost - x->bound), steepness;
  compute_scaling(p, k->s, z, k);
  apply_scaling(p, k, k->s, k->lam);
  apply_scaling(p, k, k->r_s, k->scaled);
  product(p, k->lam, k->lam, k->square);
  edge_hessians(p, k);
  factor_path(p, k);
  for (int i = 0; i < signals; i++) k->constant_w[i] = -p->cost[i];
  solve_path(p, k, k->constant_w, p->b, k->constant_p);
  steepness = dot(p->cost, k->constant_w, signals) + dot(p->b, k->constant_p, p->equations) - kappa / tau;
  memcpy(k->aim, k->square, sizeof(double) * (size_t)cones);
  for (int phase = 0; phase < 2; phase++) {
    double rest = 1 - sigma, dtau, dkappa, slope, *shifted = k->of_z, *of_rows = k->ds;
    quotient(p, k->lam, k->aim, k->second, k);
    for (int i = 0; i < cones; i++) shifted[i] = rest * k->scaled[i] - k->second[i];
    for (int i = 0; i < signals; i++) k->dw[i] = -rest * k->r_w[i];
    apply_scaling(p, k, shifted, k->dz);
    add_cone_adjoint(p, -1.0, k->dz, k->dw);
    for (int i = 0; i < p->equations; i++) k->more[i] = -rest * k->r_p[i];
    solve_path(p, k, k->dw, k->more, k->dp);
    dtau = -rest * r_tau + d_kappa / tau - dot(p->cost, k->dw, signals) - dot(p->b, k->dp, p->equations);
    dtau /= steepness;
    add(k->dw, dtau, k->constant_w, signals);
    add(k->dp, dtau, k->constant_p, p->equations);
    memset(of_rows, 0, sizeof(double) * (size_t)cones);
    add_cone_rows(p, k->dw, of_rows);
    apply_scaling(p, k, of_rows, k->of_s);
    for (int i = 0; i < cones; i++) {
      k->of_z[i] += k->of_s[i];
      k->of_s[i] = -rest * k->scaled[i] - k->of_s[i];
      k->ds[i] = -rest * k->r_s[i] - of_rows[i];
    }
    apply_scaling(p, k, k->of_z, k->dz);
    dkappa = -(d_kappa + kappa * dtau) / tau;
    slope = larger(larger(steepest(p, k, k->of_s), steepest(p, k, k->of_z)), larger(-dtau / tau, -dkappa / kappa));
    if (phase == 0) {
      double left = 1 - smaller(1 / larger(slope, FRACTION), 1.0);
      sigma = left * left * left;
      product(p, k->of_s, k->of_z, k->second);
      for (int i = 0; i < cones; i++)
        k->aim[i] = k->square[i] + k->second[i] - (i < (p->linear + 1) * E ? sigma * x->mu : 0.0);
      d_kappa += dkappa * dtau - sigma * x->mu;
      continue;
    }
    a = FRACTION / larger(slope, FRACTION);
    add(w, a, k->dw, signals);
    add(v, a, k->dp, p->equations);
    add(z, a, k->dz, cones);
    add(k->s, a, k->ds, cones);
    x->tau = tau + a * dtau, x->kappa = kappa + a * dkappa;
  }
  return a;
}

/* Move v well inside the cone if it is not. */
static void move_within(const lfo_path *p, work *k, double *v) {
  double least = margin(p, v, k), size = larger(1.0, size_of(v, (p->linear + p->conic) * p->edges));
  if (least < INTERIOR * size)
    for (int i = 0; i < (p->linear + 1) * p->edges; i++) v[i] += larger(1.0, MOVED * size) - least;
}

/* The first point, from the solution at W = 1. */
static void start(const lfo_path *p, work *k, double *w, double *v, double *z) {
  int E = p->edges, signals = p->width * E, cones = (p->linear + p->conic) * E;
  for (int i = 0; i < cones; i++) k->scale[i] = i < (p->linear + 1) * E ? 1.0 : 0.0;
  for (int e = 0; e < E; e++) k->eta[e] = 1.0;
  edge_hessians(p, k);
  factor_path(p, k);
  for (int i = 0; i < signals; i++) w[i] = -p->cost[i];
  solve_path(p, k, w, p->b, v);
  memset(z, 0, sizeof(double) * (size_t)cones);
  add_cone_rows(p, w, z);
  for (int i = 0; i < cones; i++) k->s[i] = -z[i];
  move_within(p, k, k->s);
  move_within(p, k, z);
}

/* Place the arrays in memory that is returned, NULL if there is none; find the band. */
static double *begin(const lfo_path *p, work *k) {
  int E = p->edges, W = p->width, q = p->coupled, a = p->signals, vertices = p->equations - q;
  size_t cones = (size_t)(p->linear + p->conic) * E, signals = (size_t)W * E, equations = (size_t)p->equations;
  size_t other = (size_t)(p->times + 1) * (a > p->modes ? a : p->modes), sums = other > (size_t)E ? other : (size_t)E;
  double **parts[] = {&k->L, &k->X, &k->border, &k->rest, &k->moments, &k->scale, &k->eta, &k->lam, &k->square,
                      &k->scaled, &k->aim, &k->second, &k->of_z, &k->of_s, &k->r_w, &k->r_p, &k->r_s, &k->dw, &k->dp,
                      &k->dz, &k->ds, &k->constant_w, &k->constant_p, &k->s, &k->edge, &k->more, &k->slope, &k->cone,
                      &k->value, &k->sums, &k->S};
  size_t sizes[] = {signals * W, signals * (p->rows + a), (size_t)vertices * q, (size_t)q * q,
                    (size_t)p->times * a * a, cones, (size_t)E, cones, cones, cones, cones, cones, cones, cones, signals,
                    equations, cones, signals, equations, cones, cones, signals, equations, cones, signals,
                    signals + equations, signals, cones, (size_t)E + equations, sums, 0};
  size_t total = 0;
  double *memory;
  k->last = malloc(sizeof(int) * (equations + 1));
  if (!k->last) return NULL;
  for (int i = 0; i < vertices; i++) k->last[i] = i;
  k->band = 1;
  for (int e = 0; e < E; e++) {
    int64_t most = -1;
    for (int r = 0; r < p->rows; r++) most = p->place[r * E + e] > most ? p->place[r * E + e] : most;
    for (int r = 0; r < p->rows; r++)
      if (p->place[r * E + e] >= 0 && most > k->last[p->place[r * E + e]]) k->last[p->place[r * E + e]] = (int)most;
  }
  for (int i = 0; i < vertices; i++) { /* elimination fills the rows below as far as those above reach */
    if (i && k->last[i - 1] > k->last[i]) k->last[i] = k->last[i - 1];
    if (k->last[i] - i >= k->band) k->band = k->last[i] - i + 1;
  }
  sizes[30] = (size_t)vertices * k->band;
  for (int i = 0; i < 31; i++) total += sizes[i];
  memory = malloc(sizeof(double) * (total + 1));
  if (!memory) {
    free(k->last);
    return NULL;
  }
  total = 0;
  for (int i = 0; i < 31; i++) {
    *parts[i] = memory + total;
    total += sizes[i];
  }
  return memory;
}

/* Run from the first point until it ends, and return how; w (W, E), v (equations), z (linear + conic, E) and
   (tau, bound, proven) are those of the last point. The tolerances are those of the point and of its proven bound. */
int lfo_path_run(const lfo_path *p, double *w, double *v, double *z, double *ends, double tolerance, double proven,
                 double cutoff, double clear) {
  work k;
  numbers x = {1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -INFINITY};
  double *memory = begin(p, &k);
  int end = memory ? -1 : STALLED;
  if (memory) start(p, &k, w, v, z);
  for (int step = 0; end < 0; step++) {
    measure(p, &k, w, v, z, &x);
    if (step >= BOUNDED_FROM) x.proven = proven_bound(p, &k, w, v, z, x.tau);
    end = end_of_run(&x, tolerance, proven, cutoff, clear);
    if (end < 0 && (step == MOST_STEPS || !(take_step(p, &k, w, v, z, &x) > SHORTEST_STEP && x.tau > 0))) end = STALLED;
  }
  ends[TAU] = x.tau, ends[BOUND] = x.bound, ends[PROVEN] = x.proven;
  if (memory) {
    free(memory);
    free(k.last);
  }
  return end;
}
