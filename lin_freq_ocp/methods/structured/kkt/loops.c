/* The loops over stages, and factors of small symmetric matrices. recursions.py says what each of them returns.

   Riccati recursion in Joseph form, from P_{T+1} = 0, p_{T+1} = 0; nothing is subtracted from P:

       S = Phi_ww + B'P B,   K = -S^-1 (Phi_wx + B'P A),   A_c = A + B K,
       P_t = Phi_xx + K'Phi_ww K + Phi_xw K + K'Phi_wx + A_c'P_{t+1} A_c,
       v = p_{t+1} + P_{t+1} c,   p_t = r_x + K'r_w + A_c'v,   w_t = K x_t - S^-1 (r_w + B'v),   eta_t = -(P x + p)_{t+1}.

   Matrices are stored by rows. Each file of arrays has one entry a stage as its first index. */
#include <string.h>

#include "../../dense.h"

#define COPY(to, from, count) memcpy(to, from, sizeof(double) * (size_t)(count))
#define CLEAR(array, count) memset(array, 0, sizeof(double) * (size_t)(count))

typedef struct { /* the stages and their factors; L and P_{T+1} are zero before, and P0 is the factor of a block of P_0 */
  integer stages, n, k, count; /* T + 1, the sizes of x and w, and how many entries of x_0 are free */
  const integer *free;
  const double *A, *B;
  double *K, *L, *Ac, *P, *P0;
} lfo_regulator;

/* out += M v. */
static void add_times(double *out, const double *M, const double *v, integer rows, integer columns) {
  for (integer i = 0; i < rows; i++) out[i] += dot(M + i * columns, v, columns);
}

/* out += M'v. */
static void add_transposed_times(double *out, const double *M, const double *v, integer rows, integer columns) {
  for (integer i = 0; i < rows; i++) add(out, v[i], M + i * columns, columns);
}

typedef struct { /* a matrix whose entry (i, j) is at [i * down + j * along] */
  const double *at;
  integer down, along;
} view;

/* out += the product of (rows, inner) and (inner, columns); if ``lower``, in the lower triangle alone. */
static void add_product(double *restrict out, view a, const double *restrict b, integer rows, integer inner,
                        integer columns, int lower) {
  for (integer i = 0; i < rows; i++) {
    double *restrict row = out + i * columns;
    const double *factor = a.at + i * a.down;
    integer width = lower ? i + 1 : columns, m = 0;
    for (; m + 3 < inner; m += 4) { /* four rows at once: each entry of out is loaded and stored once */
      double f0 = factor[m * a.along], f1 = factor[(m + 1) * a.along];
      double f2 = factor[(m + 2) * a.along], f3 = factor[(m + 3) * a.along];
      const double *b0 = b + m * columns, *b1 = b0 + columns, *b2 = b1 + columns, *b3 = b2 + columns;
#pragma omp simd
      for (integer j = 0; j < width; j++) row[j] += (f0 * b0[j] + f1 * b1[j]) + (f2 * b2[j] + f3 * b3[j]);
    }
    for (; m < inner; m++) add(row, factor[m * a.along], b + m * columns, width);
  }
}

static void scale(double *v, double factor, integer count) {
  for (integer i = 0; i < count; i++) v[i] *= factor;
}

/* Replace b (size, columns) by (L L')^-1 b. */
static void cholesky_solve(const double *L, integer size, double *b, integer columns) {
  for (integer i = 0; i < size; i++) {
    for (integer m = 0; m < i; m++) add(b + i * columns, -L[i * size + m], b + m * columns, columns);
    scale(b + i * columns, 1 / L[i * size + i], columns);
  }
  for (integer i = size - 1; i >= 0; i--) {
    for (integer m = i + 1; m < size; m++) add(b + i * columns, -L[m * size + i], b + m * columns, columns);
    scale(b + i * columns, 1 / L[i * size + i], columns);
  }
}

/* Copy the leading columns of rows that are ``stride`` apart. */
static void copy_block(double *out, const double *from, integer rows, integer columns, integer stride) {
  for (integer i = 0; i < rows; i++) COPY(out + i * columns, from + i * stride, columns);
}

/* One stage: the factor L of S, K and A_c, from P_{t+1}; work (k, n). */
static void gains(const double *A, const double *B, const double *Phi, const double *P, double *K, double *L,
                  double *Ac, double *work, integer n, integer k, double least) {
  integer nz = n + k;
  CLEAR(work, k * n); /* B'P */
  add_product(work, (view){B, 1, k}, P, k, n, n, 0);
  for (integer i = 0; i < k; i++) COPY(L + i * k, Phi + (n + i) * nz + n, i + 1);
  add_product(L, (view){work, n, 1}, B, k, n, k, 1);
  cholesky(L, k, least);
  copy_block(K, Phi + n * nz, k, n, nz);
  add_product(K, (view){work, n, 1}, A, k, n, n, 0);
  scale(K, -1, k * n);
  cholesky_solve(L, k, K, n);
  COPY(Ac, A, n * n);
  add_product(Ac, (view){B, k, 1}, K, n, k, n, 0);
}

/* One stage: P_t from P_{t+1}; work ((n + k), n). */
static void cost_to_go(const double *Phi, const double *P, const double *K, const double *Ac, double *out,
                       double *work, integer n, integer k) {
  integer nz = n + k;
  double *PA = work, *UK = work + n * n; /* P A_c, and Phi_wx + Phi_ww K */
  CLEAR(PA, n * n);
  add_product(PA, (view){P, n, 1}, Ac, n, n, n, 0);
  copy_block(UK, Phi + n * nz, k, n, nz);
  add_product(UK, (view){Phi + n * nz + n, nz, 1}, K, k, k, n, 0);
  copy_block(out, Phi, n, n, nz);
  add_product(out, (view){Ac, 1, n}, PA, n, n, n, 1);
  add_product(out, (view){K, 1, n}, UK, n, k, n, 1);
  add_product(out, (view){Phi + n, nz, 1}, K, n, k, n, 1);
  for (integer i = 0; i < n; i++)
    for (integer j = 0; j < i; j++) out[j * n + i] = out[i * n + j];
}

/* Whether a pivot is above rounding, relative to an entry of the diagonal of Phi. */
static int is_curved(double root, const double *Phi, integer i, integer nz, double least) {
  return root * root > least * fabs(Phi[i * (nz + 1)]);
}

/* Fill the factors; if ``curved`` is not negative, up to the first pivot that is not above so many times the curvature of
   its stage. Return whether there is none. work ((n + k), n). */
int lfo_factor(const lfo_regulator *s, const double *Phi, double *work, double least, double curved) {
  integer n = s->n, k = s->k, nz = n + k, count = s->count, nn = n * n, zz = nz * nz;
  for (integer t = s->stages - 1; t >= 0; t--) {
    const double *own = Phi + t * zz, *after = s->P + (t + 1) * nn;
    double *K = s->K + t * k * n, *L = s->L + t * k * k, *Ac = s->Ac + t * nn;
    gains(s->A + t * nn, s->B + t * n * k, own, after, K, L, Ac, work, n, k, least);
    for (integer j = 0; j < k; j++)
      if (curved >= 0 && !is_curved(L[j * (k + 1)], own, n + j, nz, curved)) return 0;
    cost_to_go(own, after, K, Ac, s->P + t * nn, work, n, k);
  }
  for (integer i = 0; i < count; i++)
    for (integer j = 0; j <= i; j++) s->P0[i * count + j] = s->P[s->free[i] * n + s->free[j]];
  cholesky(s->P0, count, least);
  for (integer j = 0; j < count; j++)
    if (curved >= 0 && !is_curved(s->P0[j * (count + 1)], Phi, s->free[j], nz, curved)) return 0;
  return 1;
}

/* x_0 in x, and lam0 in the place of p_0, from the cost-to-go of the first stage; work (count). */
static void first_state(const lfo_regulator *s, const double *x0, double *x, double *lam0, double *work) {
  integer n = s->n, count = s->count;
  COPY(x, x0, n);
  for (integer f = 0; f < count; f++) work[f] = -(lam0[s->free[f]] + dot(s->P + s->free[f] * n, x0, n));
  cholesky_solve(s->P0, count, work, 1);
  for (integer f = 0; f < count; f++) x[s->free[f]] = work[f];
  add_times(lam0, s->P, x, n, n);
  scale(lam0, -1, n);
  for (integer f = 0; f < count; f++) lam0[s->free[f]] = 0;
}

/* y, eta and lam0; work (n). Until x is known, y has w - K x, eta p_{t+1}, and lam0 p_0. */
void lfo_solve(const lfo_regulator *s, const double *r, const double *c, const double *x0, double *y, double *eta,
               double *lam0, double *work) {
  integer T = s->stages - 1, n = s->n, k = s->k, nn = n * n, nk = n * k, nz = n + k;
  CLEAR(eta + T * n, n);
  for (integer t = T; t >= 0; t--) {
    const double *of_w = r + t * nz + n, *after = eta + t * n;
    double *w = y + t * nz + n, *p = t > 0 ? eta + (t - 1) * n : lam0;
    COPY(work, after, n);
    add_transposed_times(work, s->P + (t + 1) * nn, c + t * n, n, n);
    COPY(w, of_w, k);
    add_transposed_times(w, s->B + t * nk, work, n, k);
    scale(w, -1, k);
    cholesky_solve(s->L + t * k * k, k, w, 1);
    COPY(p, r + t * nz, n);
    add_transposed_times(p, s->Ac + t * nn, work, n, n);
    add_transposed_times(p, s->K + t * nk, of_w, k, n);
  }
  first_state(s, x0, y, lam0, work);
  for (integer t = 0; t <= T; t++) {
    double *x = y + t * nz, *w = x + n, *next = t < T ? x + nz : work;
    add_times(w, s->K + t * nk, x, k, n);
    COPY(next, c + t * n, n);
    add_times(next, s->A + t * nn, x, n, n);
    add_times(next, s->B + t * nk, w, n, k);
    add_transposed_times(eta + t * n, s->P + (t + 1) * nn, next, n, n);
    scale(eta + t * n, -1, n);
  }
}

/* out = H + G'W^-2 G for G (rows, nz) of each stage; the last rows are cones of these sizes, of which
   G'W^-2 G = (2 q q' - G'J G)/eta^2. A weight of zero says that there is no such row. work (nz). */
void lfo_gram(integer stages, integer rows, integer nz, integer linear, integer cones, const double *H, const double *G,
              const double *weights, const double *points, const integer *sizes, double *out, double *work) {
  COPY(out, H, stages * nz * nz);
  for (integer t = 0; t < stages; t++) {
    const double *weight = weights + t * (linear + cones), *w = points + t * (rows - linear) - linear;
    const double *Gt = G + t * rows * nz;
    double *total = out + t * nz * nz;
    for (integer i = 0; i < linear; i++) {
      if (weight[i] == 0) continue;
      for (integer a = 0; a < nz; a++) /* most rows are bounds of one entry */
        if (Gt[i * nz + a] != 0) add(total + a * nz, weight[i] * Gt[i * nz + a], Gt + i * nz, nz);
    }
    for (integer j = 0, first = linear; j < cones; first += sizes[j++]) {
      double squared = weight[linear + j];
      if (squared == 0) continue;
      CLEAR(work, nz);
      for (integer i = first; i < first + sizes[j]; i++) {
        const double *row = Gt + i * nz;
        double sign = i == first ? 1 : -1;
        add(work, sign * w[i], row, nz);
        for (integer a = 0; a < nz; a++) add(total + a * nz, -sign * squared * row[a], row, nz);
      }
      for (integer a = 0; a < nz; a++) add(total + a * nz, 2 * squared * work[a], work, nz);
    }
  }
}

/* The states of y, which start anew at the breaks, and the states there before that, in ``reached``. */
void lfo_forward(integer stages, integer n, integer k, integer count, const double *A, const double *B, const double *c,
                 const integer *breaks, const double *starts, double *y, double *reached) {
  integer nz = n + k, done = 0;
  for (integer t = 0; t + 1 < stages; t++) {
    double *x = y + t * nz, *next = x + nz;
    COPY(next, c + t * n, n);
    add_times(next, A + t * n * n, x, n, n);
    add_times(next, B + t * n * k, x + n, n, k);
    if (done < count && breaks[done] == t + 1) {
      COPY(reached + done * n, next, n);
      COPY(next, starts + done * n, n);
      done++;
    }
  }
}

/* The costates p, and the gradients in w and in the starts; at a break, -prices take the place of the costate. */
void lfo_backward(integer stages, integer n, integer k, integer count, const double *A, const double *B,
                  const double *gradient, const integer *breaks, const double *prices, double *p, double *gw,
                  double *gstarts) {
  integer nz = n + k, left = count - 1;
  for (integer t = stages - 1; t >= 0; t--) {
    double *own = p + t * n, *after = own + n;
    COPY(gw + t * k, gradient + t * nz + n, k);
    COPY(own, gradient + t * nz, n);
    if (t + 1 < stages) { /* A_T and B_T are zero */
      add_transposed_times(gw + t * k, B + t * n * k, after, n, k);
      add_transposed_times(own, A + t * n * n, after, n, n);
    }
    if (left >= 0 && breaks[left] == t) {
      COPY(gstarts + left * n, own, n);
      for (integer i = 0; i < n; i++) own[i] = -prices[left * n + i];
      left--;
    }
  }
}
