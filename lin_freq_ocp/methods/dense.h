/* Sums of products and the factor of a small symmetric matrix, for the C files that include it. */
#include <math.h>
#include <stddef.h>

typedef ptrdiff_t integer;

static double dot(const double *a, const double *b, integer count) {
  double sum = 0;
#pragma omp simd reduction(+ : sum)
  for (integer i = 0; i < count; i++) sum += a[i] * b[i];
  return sum;
}

static void add(double *restrict out, double factor, const double *restrict v, integer count) {
#pragma omp simd
  for (integer i = 0; i < count; i++) out[i] += factor * v[i];
}

/* Replace the lower triangle by its factor; the largest diagonal entry sets the pivot of a zero row. */
static void cholesky(double *M, integer size, double least) {
  double largest = 0;
  for (integer j = 0; j < size; j++) largest = M[j * size + j] > largest ? M[j * size + j] : largest;
  if (largest == 0) largest = 1;
  for (integer j = 0; j < size; j++) {
    double *row = M + j * size, pivot = row[j] - dot(row, row, j);
    double floor = least * (row[j] > 0 ? row[j] : largest);
    row[j] = sqrt(floor > pivot ? floor : pivot); /* an undefined pivot stays */
    for (integer i = j + 1; i < size; i++) M[i * size + j] = (M[i * size + j] - dot(M + i * size, row, j)) / row[j];
  }
}
