/* The particle stages as one writes them first: one loop over particles in memory order, one particle at a time, a whole
 * mesh in one array, nothing shared between ranks. What amrpic's stages are compared with, in the same process and in turns;
 * so goals hold for any processor. Periodic cubes of n^3 cells of unit length, columns in SI units. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

static inline void cell(double x, int n, int at[2], double weight[2]) {
  double const s = x * n - 0.5, below = floor(s);
  int const i = (int)below;
  at[0] = i < 0 ? i + n : i;
  at[1] = i + 1 >= n ? i + 1 - n : i + 1;
  weight[1] = s - below;
  weight[0] = 1 - weight[1];
}

/* Add charge by clouds-in-cells to rho, which is zeroed first. */
void deposit(int64_t count, int n, double const *x, double const *y, double const *z, double const *w, double *rho) {
  memset(rho, 0, sizeof(double) * n * n * n);
  for (int64_t p = 0; p < count; ++p) {
    int i[2], j[2], k[2];
    double a[2], b[2], c[2];
    cell(x[p], n, i, a), cell(y[p], n, j, b), cell(z[p], n, k, c);
    for (int r = 0; r < 2; ++r)
      for (int s = 0; s < 2; ++s)
        for (int t = 0; t < 2; ++t) rho[i[t] + (size_t)n * (j[s] + (size_t)n * k[r])] += w[p] * a[t] * b[s] * c[r];
  }
}

/* Gather the field, three numbers per cell side by side, kick by `kick` (C s), and drift for dt with the mass m. */
void gather_and_push(int64_t count, int n, double const *const in[6], double const *field, double kick, double mass,
                     double dt, double *const out[6]) {
  double const light = 299792458.0, per_mc = 1 / (mass * light);
  for (int64_t p = 0; p < count; ++p) {
    int at[3][2];
    double weight[3][2], e[3] = {0, 0, 0}, u[3];
    for (int d = 0; d < 3; ++d) cell(in[d][p], n, at[d], weight[d]);
    for (int r = 0; r < 2; ++r)
      for (int s = 0; s < 2; ++s)
        for (int t = 0; t < 2; ++t) {
          double const *here = field + 3 * (at[0][t] + (size_t)n * (at[1][s] + (size_t)n * at[2][r]));
          double const all = weight[0][t] * weight[1][s] * weight[2][r];
          for (int d = 0; d < 3; ++d) e[d] += all * here[d];
        }
    double square = 0;
    for (int d = 0; d < 3; ++d) {
      out[3 + d][p] = in[3 + d][p] + kick * e[d];
      u[d] = out[3 + d][p] * per_mc;
      square += u[d] * u[d];
    }
    double const far = light * dt / sqrt(1 + square);
    for (int d = 0; d < 3; ++d) out[d][p] = in[d][p] + far * u[d];
  }
}

/* Wrap places and sort all columns and ids by bricks of 8^3 cells: count, sum, copy. */
void migrate(int64_t count, int n, double const *const in[6], int64_t const *id, double *const out[6], int64_t *id_out) {
  int const bricks = (n + 7) / 8;
  size_t const all = (size_t)bricks * bricks * bricks;
  int64_t *start = calloc(all + 1, sizeof *start);
  int32_t *key = malloc(sizeof *key * count);
  for (int64_t p = 0; p < count; ++p) {
    int b[3];
    for (int d = 0; d < 3; ++d) {
      double const x = in[d][p] - floor(in[d][p]);
      int const c = (int)(x * n);
      b[d] = (c < n ? c : n - 1) / 8;
    }
    key[p] = b[0] + bricks * (b[1] + bricks * b[2]);
    ++start[key[p] + 1];
  }
  for (size_t k = 0; k < all; ++k) start[k + 1] += start[k];
  for (int64_t p = 0; p < count; ++p) {
    int64_t const to = start[key[p]]++;
    for (int d = 0; d < 3; ++d) {
      out[d][to] = in[d][p] - floor(in[d][p]);
      out[3 + d][to] = in[3 + d][p];
    }
    id_out[to] = id[p];
  }
  free(key), free(start);
}

/* Means, spreads and products of places and momenta over m c, in two passes, and the kinetic energy over m c^2: 19 sums. */
void moments(int64_t count, double const *const in[6], double const *later[3], double const *w, double mass, double *out) {
  double const per_mc = 1 / (mass * 299792458.0);
  memset(out, 0, sizeof(double) * 19);
  for (int64_t p = 0; p < count; ++p) {
    double square = 0;
    for (int d = 0; d < 3; ++d) {
      double const u = 0.5 * (in[3 + d][p] + later[d][p]) * per_mc;
      out[d] += w[p] * in[d][p], out[3 + d] += w[p] * u, square += u * u;
    }
    out[6] += w[p], out[7] += w[p] * square / (sqrt(1 + square) + 1);
  }
  for (int64_t p = 0; p < count; ++p)
    for (int d = 0; d < 3; ++d) {
      double const x = in[d][p] - out[d] / out[6];
      double const u = 0.5 * (in[3 + d][p] + later[d][p]) * per_mc - out[3 + d] / out[6];
      out[8 + d] += w[p] * x * x, out[11 + d] += w[p] * u * u, out[14 + d] += w[p] * x * u;
    }
}
