/* The slider crank of problems/slider_crank.py by hand: generalized-alpha on index 3, full Newton's
   method with the analytic tangent, dense LU with partial pivoting, every size known when compiled.

   It solves the same discrete equations as integrators/alpha_step.py (unknowns a and lam, constraint
   rows divided by dq/da), so that its answers agree to rounding, and says what a program can cost
   that does nothing else. Nothing is checked: no status, no NaN, no rows but the last.

   cc -O3 -march=native yardstick_slider_crank.c -lm; a.out STEPS SECONDS RHO_INF
   prints: microseconds per step, Newton iterations per step, q and a at the end. With a fourth
   argument, the name of a method, it prints all rows for `stepbench judge`. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { NQ = 7, NL = 6, N = NQ + NL, CRANK = 2, ROD = 5 };

static const double l1 = 0.15, l2 = 0.3, m1 = 0.36, m2 = 0.15, m3 = 0.075, g = 9.81;
/* The coordinate that each constraint places: x1 y1 x2 y2 x3, and none for the guide. */
static const int placed[NL] = {0, 1, 3, 4, 6, -1};
/* Its reach along crank and rod, and whether it looks along x or y. */
static const double on_crank[NL] = {0.5, 0.5, 1.0, 1.0, 1.0, -1.0};
static const double on_rod[NL] = {0.0, 0.0, 0.5, 0.5, 1.0, -1.0};
static const int across[NL] = {0, 1, 0, 1, 0, 1};
static double mass[NQ];
static const double weight[NQ] = {0, 1, 0, 0, 1, 0, 0};

/* Solve A u = b in place by elimination with row exchanges; b becomes u. */
static void solve(double A[N][N], double b[N]) {
  for (int k = 0; k < N; k++) {
    int best = k;
    for (int i = k + 1; i < N; i++)
      if (fabs(A[i][k]) > fabs(A[best][k])) best = i;
    if (best != k) {
      for (int j = k; j < N; j++) {
        double swap = A[k][j];
        A[k][j] = A[best][j];
        A[best][j] = swap;
      }
      double swap = b[k];
      b[k] = b[best];
      b[best] = swap;
    }
    double reciprocal = 1 / A[k][k];
    for (int i = k + 1; i < N; i++) {
      double factor = A[i][k] * reciprocal;
      if (factor == 0) continue;
      for (int j = k + 1; j < N; j++) A[i][j] -= factor * A[k][j];
      b[i] -= factor * b[k];
    }
  }
  for (int i = N - 1; i >= 0; i--) {
    for (int j = i + 1; j < N; j++) b[i] -= A[i][j] * b[j];
    b[i] /= A[i][i];
  }
}

/* Residual r of (a, lam) at q, and its tangent where dq/da = s. */
static void linearise(const double q[NQ], const double a[NQ], const double lam[NL], double s,
                      double r[N], double A[N][N]) {
  double crank[2] = {l1 * cos(q[CRANK]), l1 * sin(q[CRANK])};
  double rod[2] = {l2 * cos(q[ROD]), l2 * sin(q[ROD])}, per_s = 1 / s;
  for (int i = 0; i < N; i++)
    for (int j = 0; j < N; j++) A[i][j] = 0;
  for (int i = 0; i < NQ; i++) {
    r[i] = mass[i] * (a[i] + g * weight[i]);
    A[i][i] = mass[i];
  }
#pragma GCC unroll 6 /* then the tables cost nothing */
  for (int k = 0; k < NL; k++) {
    int d = across[k], turned = 1 - d, at = NQ + k;
    double sign = d ? -1 : 1; /* d(cos) = -sin, d(sin) = cos */
    double by_crank = sign * on_crank[k] * crank[turned], by_rod = sign * on_rod[k] * rod[turned];
    r[at] = -on_crank[k] * crank[d] - on_rod[k] * rod[d];
    if (placed[k] >= 0) {
      r[at] += q[placed[k]];
      r[placed[k]] += lam[k];
      A[placed[k]][at] = A[at][placed[k]] = 1;
    }
    r[at] *= per_s;
    r[CRANK] += by_crank * lam[k];
    r[ROD] += by_rod * lam[k];
    A[CRANK][at] = A[at][CRANK] = by_crank;
    A[ROD][at] = A[at][ROD] = by_rod;
    A[CRANK][CRANK] += s * on_crank[k] * crank[d] * lam[k];
    A[ROD][ROD] += s * on_rod[k] * rod[d] * lam[k];
  }
}

/* Consistent positions, velocities, accelerations and multipliers of the crank at 0.7 rad and
   10 rad/s. */
static void start(double q[NQ], double v[NQ], double a[NQ], double lam[NL]) {
  double th = 0.7, w1 = 10, ph = -asin(l1 / l2 * sin(th));
  double w2 = -l1 * cos(th) * w1 / (l2 * cos(ph));
  double crank[2] = {l1 * cos(th), l1 * sin(th)}, rod[2] = {l2 * cos(ph), l2 * sin(ph)};
  double A[N][N], r[N], zero[N] = {0};
  q[CRANK] = th, q[ROD] = ph, v[CRANK] = w1, v[ROD] = w2;
  for (int k = 0; k < NL; k++)
    if (placed[k] >= 0) {
      int d = across[k];
      double sign = d ? 1 : -1;
      q[placed[k]] = on_crank[k] * crank[d] + on_rod[k] * rod[d];
      v[placed[k]] = sign * (on_crank[k] * crank[1 - d] * w1 + on_rod[k] * rod[1 - d] * w2);
    }
  linearise(q, zero, zero, 1, r, A);
  for (int k = 0; k < NL; k++) /* the part of d2/dt2 Phi that the velocities make */
    r[NQ + k] =
        on_crank[k] * crank[across[k]] * w1 * w1 + on_rod[k] * rod[across[k]] * w2 * w2;
  solve(A, r);
  for (int i = 0; i < NQ; i++) a[i] = -r[i];
  for (int i = 0; i < NL; i++) lam[i] = -r[NQ + i];
}

static double largest(const double *values, int count) {
  double most = 0;
  for (int i = 0; i < count; i++)
    if (fabs(values[i]) > most) most = fabs(values[i]);
  return most;
}

static void cells(const char *group, const double *values, int count) {
  for (int i = 0; i < count; i++)
    if (values)
      printf(",%.17g", values[i]);
    else
      printf(",%s%d", group, i + 1);
}

/* A row for `stepbench judge`, or its head if there are no values. */
static void row(double t, const double *q, const double *v, const double *a, const double *lam) {
  if (q)
    printf("%.17g", t);
  else
    printf("t");
  cells("q", q, NQ), cells("v", v, NQ), cells("a", a, NQ), cells("lam", lam, NL);
  printf("\n");
}

int main(int count, char **given) {
  int steps = count > 1 ? atoi(given[1]) : 20000;
  double h = (count > 2 ? atof(given[2]) : 5.0) / steps, rho = count > 3 ? atof(given[3]) : 0.8;
  double am = (2 * rho - 1) / (rho + 1), af = rho / (rho + 1), gamma = 0.5 + af - am;
  double beta = 0.25 * (gamma + 0.5) * (gamma + 0.5), slope = (1 - af) / (1 - am);
  double s = h * h * beta * slope, sv = h * gamma * slope;
  mass[0] = mass[1] = m1, mass[CRANK] = m1 * l1 * l1 / 12;
  mass[3] = mass[4] = m2, mass[ROD] = m2 * l2 * l2 / 12, mass[6] = m3;

  double q[NQ], v[NQ], a[NQ], aux[NQ], lam[NL], base_q[NQ], base_v[NQ], base_aux[NQ];
  double r[N], A[N][N];
  long iterations = 0;
  struct timespec from, to;
  const char *method = count > 4 ? given[4] : NULL;
  start(q, v, a, lam);
  for (int i = 0; i < NQ; i++) aux[i] = a[i];
  if (method) {
    printf("# step=%.17g method=%s\n", h, method);
    row(0, NULL, NULL, NULL, NULL);
    row(0, q, v, a, lam);
  }
  for (int i = 0; i < NL; i++) lam[i] = 0;

  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &from);
  for (int n = 0; n < steps; n++) {
    for (int i = 0; i < NQ; i++) {
      base_aux[i] = (af * a[i] - am * aux[i]) / (1 - am);
      base_q[i] = q[i] + h * v[i] + h * h * ((0.5 - beta) * aux[i] + beta * base_aux[i]);
      base_v[i] = v[i] + h * ((1 - gamma) * aux[i] + gamma * base_aux[i]);
    }
    for (int k = 0; k < 20; k++) {
      for (int i = 0; i < NQ; i++) q[i] = base_q[i] + s * a[i];
      linearise(q, a, lam, s, r, A);
      solve(A, r);
      for (int i = 0; i < NQ; i++) a[i] -= r[i];
      for (int i = 0; i < NL; i++) lam[i] -= r[NQ + i];
      iterations++;
      /* Convergence is quadratic: what is left is far smaller than the last update. */
      if (largest(r, NQ) < 1e-7 * largest(a, NQ)) break;
    }
    for (int i = 0; i < NQ; i++) {
      q[i] = base_q[i] + s * a[i];
      v[i] = base_v[i] + sv * a[i];
      aux[i] = base_aux[i] + slope * a[i];
    }
    if (method) row((n + 1) * h, q, v, a, lam);
  }
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &to);

  double seconds = (to.tv_sec - from.tv_sec) + 1e-9 * (to.tv_nsec - from.tv_nsec);
  if (method) {
    printf("# seconds=%.17g newton=%ld steps=%d\n", seconds, iterations, steps);
    return 0;
  }
  printf("%.6f %.4f", 1e6 * seconds / steps, (double)iterations / steps);
  for (int i = 0; i < NQ; i++) printf(" %.17g", q[i]);
  for (int i = 0; i < NQ; i++) printf(" %.17g", a[i]);
  printf("\n");
  return 0;
}
