/* Laws of one-way delays in us, drawn from a seeded generator. */

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

struct law {
    double (*excess_us)(struct law *); /* draws what comes on top of the minimum */
    double minimum_us, mean_us, shape;
    double wait_us, quick_us; /* where some are quick: of the others at least, and of the quick ones on average */
    uint64_t random_state;
};

/* SplitMix64 (Steele, Lea and Flood 2014). */
static uint64_t random_bits(uint64_t *state)
{
    uint64_t bits = *state += UINT64_C(0x9e3779b97f4a7c15);
    bits = (bits ^ (bits >> 30)) * UINT64_C(0xbf58476d1ce4e5b9);
    bits = (bits ^ (bits >> 27)) * UINT64_C(0x94d049bb133111eb);
    return bits ^ (bits >> 31);
}

/* Evenly in (0, 1), neither end included: its logarithm is finite. */
static double uniform(struct law *law)
{
    return ((double)(random_bits(&law->random_state) >> 12) + 0.5) / 4503599627370496.0;
}

/* Box and Muller 1958. */
static double normal(struct law *law)
{
    double radius = sqrt(-2.0 * log(uniform(law)));
    return radius * cos(2.0 * M_PI * uniform(law));
}

/* Gamma of unit scale (Marsaglia and Tsang 2000); a shape below 1 by their remark on the power of a uniform. */
static double gamma_unit(struct law *law, double shape)
{
    if (shape < 1.0)
        return gamma_unit(law, shape + 1.0) * pow(uniform(law), 1.0 / shape);
    double third = shape - 1.0 / 3.0, scale = 1.0 / sqrt(9.0 * third);
    for (;;) {
        double x = normal(law), root = 1.0 + scale * x;
        if (root <= 0.0)
            continue;
        double cube = root * root * root;
        if (log(uniform(law)) < 0.5 * x * x + third * (1.0 - cube + log(cube)))
            return third * cube;
    }
}

static double constant_excess(struct law *law)
{
    (void)law;
    return 0.0;
}

static double gamma_excess(struct law *law)
{
    return gamma_unit(law, law->shape) * (law->mean_us - law->minimum_us) / law->shape;
}

static double lognormal_excess(struct law *law)
{
    double middle = log(law->mean_us - law->minimum_us) - law->shape * law->shape / 2.0;
    return exp(middle + law->shape * normal(law));
}

static double waiting_excess(struct law *law)
{
    double mean_us = law->mean_us - law->minimum_us - law->wait_us;
    return law->wait_us + gamma_unit(law, law->shape) * mean_us / law->shape;
}

static double quick_excess(struct law *law)
{
    return -law->quick_us * log(uniform(law));
}

static const struct {
    const char *name;
    double (*excess_us)(struct law *);
    int numbers;
} LAWS[] = {
    {"constant", constant_excess, 1},
    {"gamma", gamma_excess, 3},
    {"lognormal", lognormal_excess, 3},
    {"rare", waiting_excess, 5},
};

/* When a link is quick, both ways: time is in slots, each quick or not by chance, and none at first. */
struct moments {
    uint64_t random_state;
    int64_t began_ns, last_ns;
};

enum { SLOT_NS = 4000000 };
static double quick_share;
static int64_t quick_after_ns, idle_ns = INT64_MAX;

/* Whether a frame of this moment is quick; after an idle stretch the link begins anew. */
static bool is_quick(struct moments *link, int64_t now_ns)
{
    if (!link->last_ns || now_ns - link->last_ns > idle_ns)
        link->began_ns = now_ns;
    link->last_ns = now_ns;
    uint64_t slot = link->random_state + (uint64_t)(now_ns / SLOT_NS) * UINT64_C(0x9e3779b97f4a7c15);
    return now_ns - link->began_ns >= quick_after_ns && (double)random_bits(&slot) < quick_share * 0x1p64;
}

/* Read LAW,MINIMUM_US[,MEAN_US,SHAPE[,WAIT_US,QUICK_US]]; false if it cannot be understood. */
static bool read_law(struct law *law, const char *text)
{
    char name[16];
    int read = sscanf(text, "%15[a-z],%lf,%lf,%lf,%lf,%lf", name, &law->minimum_us, &law->mean_us,
                      &law->shape, &law->wait_us, &law->quick_us);
    for (size_t i = 0; i < sizeof LAWS / sizeof *LAWS; i++)
        if (read == 1 + LAWS[i].numbers && strcmp(name, LAWS[i].name) == 0)
            law->excess_us = LAWS[i].excess_us;
    bool possible = read <= 2 || (law->mean_us > law->minimum_us + law->wait_us && law->shape > 0.0);
    return law->excess_us && law->minimum_us >= 0.0 && possible;
}
