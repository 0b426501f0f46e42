/* Floating-point operations that one core can do in a second: sums of products on numbers that stay
   in registers, ten independent ones in turn, which hides how long each of them takes.

   cc -O3 -march=native peak.c; a.out SECONDS
   prints: 1e9 operations per second with the widest registers, and with one number in each. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#if defined(__AVX512F__)
enum { WIDTH = 8 };
#elif defined(__AVX__)
enum { WIDTH = 4 };
#else
enum { WIDTH = 2 };
#endif
enum { TERMS = 10, LOOP = 1000000 };
typedef double wide __attribute__((vector_size(WIDTH * sizeof(double))));

#if defined(__x86_64__)
#define REGISTER "+x"
#else
#define REGISTER "+w"
#endif
/* The compiler may neither leave out a number nor put two of them side by side. */
#define KEPT(x) __asm__ volatile("" : REGISTER(x))
#define TEN(DO) DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7) DO(8) DO(9)
#define BEGIN(i) number x##i = one * (1.0 + i);
#define NEXT(i) x##i = x##i * factor + term; KEPT(x##i);

static double seconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return now.tv_sec + 1e-9 * now.tv_nsec;
}

#define RATE(NAME, KIND, NUMBERS)                                          \
  static double NAME(double most) {                                        \
    typedef KIND number;                                                   \
    number one = (number){0} + 1.0, factor = one * 0.999, term = one * 1e-3; \
    double best = 0.0, started = seconds();                                \
    TEN(BEGIN)                                                             \
    while (seconds() - started < most) {                                   \
      double from = seconds();                                             \
      for (int k = 0; k < LOOP; k++) { TEN(NEXT) }                         \
      double rate = 2e-9 * TERMS * LOOP * NUMBERS / (seconds() - from);    \
      best = rate > best ? rate : best;                                    \
    }                                                                      \
    return best;                                                           \
  }
RATE(of_wide_registers, wide, WIDTH)
RATE(of_numbers, double, 1)

int main(int count, char **given) {
  double most = count > 1 ? atof(given[1]) : 0.5;
  printf("%.2f %.2f\n", of_wide_registers(most), of_numbers(most));
}
