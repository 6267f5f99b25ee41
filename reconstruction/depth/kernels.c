/* The hot loops of depth for the processor; `kernels.py` calls them.
 *
 * Volumes are height x depths x width. The innermost loops go along a row and are plain, so that a compiler
 * makes vectors of them on any machine; no product is fused with a sum (-ffp-contract=off), so that all machines
 * give the same depth. Functions return 0, or 1 where there is no memory. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* One library for all x86-64: the loader takes the version that fits the processor. */
#if defined(__x86_64__) && defined(__GLIBC__) && !defined(ONE_VERSION)
#define FOR_ALL __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define FOR_ALL
#endif
/* Before a loop whose turns do not depend on each other, though they may read what another row's turns write. */
#ifdef __clang__
#define INDEPENDENT _Pragma("clang loop vectorize(assume_safety)")
#else
#define INDEPENDENT _Pragma("GCC ivdep")
#endif
#define PART static inline __attribute__((always_inline))
#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

PART float at_least(float a, float least) { return a > least ? a : least; }
PART float at_most(float a, float most) { return a < most ? a : most; }

/* ---- Costs: how unlike the sources' windows are to the reference's ---- */

typedef struct {
  const float *pixels; /* grey levels with a border, a pixel left and above, two right and below, of OUTSIDE */
  int width, height;   /* without that */
  float to[13];        /* 3x3 to its pixels from the reference's, their shift with inverse depth, its noise */
} Source;

/* Two grey levels side by side, read at once, the left one low: a gather of eight bytes costs that of four. */
typedef uint64_t two_greys __attribute__((aligned(4), may_alias));

PART float grey_of(uint32_t bits) {
  float grey;
  memcpy(&grey, &bits, sizeof grey);
  return grey;
}

/* Rows of all sources that stay in the cache while all depths are tried; columns that pass through a row's loops
 * together: a processor looks ahead no farther than a long loop's next few turns; floats of a cache line. */
enum { BAND_ROWS = 64, TILE = 128, LINE = 16 };

PART int whole_lines(int floats) { return (floats + LINE - 1) / LINE * LINE; }

PART int mirrored(int at, int size) {
  if (at < 0) at = -at;
  if (at >= size) at = 2 * size - 2 - at;
  return MAX(at, 0);
}

/* Row y of the reference as the source shows it at inverse depths `base` + `offset`; without `base`, at `offset`. */
PART void warp_row(const Source *source, int width, int y, const float *restrict base, float offset,
                   float *restrict out) {
  const float *m = source->to, *restrict pixels = source->pixels;
  const float u0 = m[1] * y + m[2], v0 = m[4] * y + m[5], z0 = m[7] * y + m[8];
  const float right = source->width, bottom = source->height;
  const int stride = source->width + 3;
  for (int left = 0; left < width; left += TILE) {
    const int n = MIN(TILE, width - left);
    float across[TILE], down[TILE];
    int at[TILE];
    for (int i = 0; i < n; i++) {
      const int x = left + i;
      const float level = base ? base[x] + offset : offset, z = m[6] * x + z0 + m[11] * level;
      const float far = 1.f / at_least(z, 1e-6f);
      const float u = (m[0] * x + u0 + m[9] * level) * far, v = (m[3] * x + v0 + m[10] * level) * far;
      /* Into the border; from its corner on nothing is negative, so that cutting off is rounding down. */
      across[i] = at_most(at_least(u, -1.f), right) + 1.f;
      down[i] = at_most(at_least(v, -1.f), bottom) + 1.f;
      at[i] = (int)down[i] * stride + (int)across[i];
    }
    for (int i = 0; i < n; i++) {
      const float a = across[i] - (int)across[i], b = down[i] - (int)down[i];
      const uint64_t upper = *(const two_greys *)(pixels + at[i]);
      const uint64_t lower = *(const two_greys *)(pixels + stride + at[i]);
      const float upper_left = grey_of((uint32_t)upper), upper_right = grey_of((uint32_t)(upper >> 32));
      const float lower_left = grey_of((uint32_t)lower), lower_right = grey_of((uint32_t)(lower >> 32));
      const float above = upper_left + (upper_right - upper_left) * a;
      const float below = lower_left + (lower_right - lower_left) * a;
      out[left + i] = above + (below - above) * b;
    }
  }
}

/* Adds a row's grey levels, their squares and their products with `grey` to the columns' sums. */
PART void add_row(int width, int wide, const float *restrict warped, const float *restrict grey,
                  float *restrict sums) {
  float *restrict squares = sums + wide, *restrict products = squares + wide;
  for (int x = 0; x < width; x++) {
    sums[x] += warped[x];
    squares[x] += warped[x] * warped[x];
    products[x] += warped[x] * grey[x];
  }
}

/* The same for the row that the windows reach next, and away with the one that they leave. */
PART void move_down(int width, int wide, const float *warped, const float *grey, const float *left,
                    const float *left_grey, float *restrict sums) {
  float *restrict squares = sums + wide, *restrict products = squares + wide;
  for (int x = 0; x < width; x++) {
    sums[x] = sums[x] + warped[x] - left[x];
    squares[x] = squares[x] + warped[x] * warped[x] - left[x] * left[x];
    products[x] = products[x] + warped[x] * grey[x] - left[x] * left_grey[x];
  }
}

/* Means of n windows, from the columns' sums. */
PART void find_means(int n, int half, const float *restrict sums, float *restrict out) {
  const float share = 1.f / ((2 * half + 1) * (2 * half + 1));
  for (int x = 0; x < n; x++) {
    float sum = sums[x - half];
    for (int k = 1 - half; k <= half; k++) sum += sums[x + k];
    out[x] = sum * share;
  }
}

/* Likeness of a row's windows, 0 to about 1, added to `total`; and the least of all sources', from the columns' sums,
 * which are mirrored into the `half` columns beside the picture. */
PART void add_likeness(int width, int wide, int half, float noise, float *restrict sums, const float *restrict mean,
                       const float *restrict deviation, float *restrict total, float *restrict least) {
  for (int i = 0; i < 3; i++)
    for (int k = 1; k <= half; k++) {
      sums[i * wide - k] = sums[i * wide + mirrored(-k, width)];
      sums[i * wide + width - 1 + k] = sums[i * wide + mirrored(width - 1 + k, width)];
    }
  for (int left = 0; left < width; left += TILE) {
    const int n = MIN(TILE, width - left);
    float a[TILE], b[TILE], c[TILE];
    find_means(n, half, sums + left, a);
    find_means(n, half, sums + wide + left, b);
    find_means(n, half, sums + 2 * wide + left, c);
    for (int i = 0; i < n; i++) {
      const int x = left + i;
      const float spread = at_least(b[i] - a[i] * a[i], 0.f);
      const float alike = at_least((c[i] - a[i] * mean[x]) / (sqrtf(spread + noise) * deviation[x]), 0.f);
      /* A mean below zero: the window touches what the source does not show. */
      const float found = a[i] < 0.f ? 0.f : alike;
      total[x] += found;
      least[x] = at_most(found, least[x]);
    }
  }
}

/* `better`: the weight of the better of two sources; of three and more the worst is left out. */
FOR_ALL int costs(int height, int width, int depths, int half, int count, const float *grey, const float *mean,
                  const float *deviation, const float *base, const float *offsets, const Source *sources,
                  float better, uint8_t *out) {
  const int kept = 2 * half + 2, stride = whole_lines(width), beside = whole_lines(half), wide = stride + 2 * beside;
  const size_t each = (size_t)kept * stride + 3 * wide;
  float *memory = malloc(sizeof(float) * (count * each + 2 * (size_t)stride + LINE));
  if (!memory) return 1;
  float *first = memory + LINE - (uintptr_t)memory / sizeof(float) % LINE;
  float *total = first + count * each, *least = total + stride;
  const float all = count == 2 ? better : count > 2 ? 1.f / (count - 1) : 1.f;
  const float worst = count == 2 ? 1.f - 2.f * better : count > 2 ? -all : 0.f;
  for (int top = 0; top < height; top += BAND_ROWS)
    for (int d = 0; d < depths; d++)
      for (int y = top; y < MIN(top + BAND_ROWS, height); y++) {
        const size_t at = (size_t)y * width;
        for (int x = 0; x < width; x++) total[x] = 0.f, least[x] = 2.f;
        for (int s = 0; s < count; s++) {
          float *rows = first + s * each, *sums = rows + (size_t)kept * stride + beside;
          if (y == top) memset(sums - beside, 0, sizeof(float) * 3 * wide);
          for (int q = y == top ? MAX(y - half, 0) : y + half; q <= MIN(y + half, height - 1); q++)
            warp_row(sources + s, width, q, base ? base + (size_t)q * width : NULL, offsets[d],
                     rows + q % kept * stride);
          if (y > top) {
            const int next = mirrored(y + half, height), left = mirrored(y - half - 1, height);
            move_down(width, wide, rows + next % kept * stride, grey + (size_t)next * width,
                      rows + left % kept * stride, grey + (size_t)left * width, sums);
          }
          for (int k = -half; y == top && k <= half; k++) {
            const int q = mirrored(y + k, height);
            add_row(width, wide, rows + q % kept * stride, grey + (size_t)q * width, sums);
          }
          const float *own = mean + at, *spread = deviation + at, noise = sources[s].to[12];
          if (half == 2) add_likeness(width, wide, 2, noise, sums, own, spread, total, least);
          else if (half == 3) add_likeness(width, wide, 3, noise, sums, own, spread, total, least);
          else add_likeness(width, wide, half, noise, sums, own, spread, total, least);
        }
        uint8_t *restrict cost = out + at * depths + (size_t)d * width;
        for (int x = 0; x < width; x++)
          cost[x] = (uint8_t)(int)(255.f - 255.f * at_most(total[x] * all + least[x] * worst, 1.f));
      }
  free(memory);
  return 0;
}

/* A source's grey levels as the reference sees them through its inverse depths. */
FOR_ALL int warp(int height, int width, const float *level, const Source *source, float *out) {
  for (int y = 0; y < height; y++)
    warp_row(source, width, y, level + (size_t)y * width, 0.f, out + (size_t)y * width);
  return 0;
}

/* Raises `nearest` (there_height x there_width) to the inverse depths of the surfaces that this view's depth shows in
 * another view, whose pixels `m` gives: see `Source`. */
FOR_ALL int splat(int height, int width, const float *depth, const float *m, int there_height, int there_width,
                  float *nearest) {
  for (int y = 0; y < height; y++)
    for (int x = 0; x < width; x++) {
      const float own = depth[(size_t)y * width + x], level = 1.f / at_least(own, 1e-12f);
      const float z = m[6] * x + m[7] * y + m[8] + m[11] * level, far = 1.f / z;
      const float u = rintf((m[0] * x + m[1] * y + m[2] + m[9] * level) * far);
      const float v = rintf((m[3] * x + m[4] * y + m[5] + m[10] * level) * far);
      if (!(own > 0.f && z > 1e-6f && u >= 0.f && u < there_width && v >= 0.f && v < there_height)) continue;
      float *at = nearest + (size_t)v * there_width + (size_t)u;
      *at = at_least(level / z, *at);
    }
  return 0;
}

/* ---- Semi-global scan (Hirschmueller 2008): 8 paths through a volume, then each pixel's cheapest depth ---- */

enum { TURNED = 32, FAR = 16000 }; /* rows that are walked along at once; what no path reaches */

/* The price of a jump of depth from `before` to `here`: half of `large` at a change of 8 grey levels, at least 1.5 small
   steps. */
PART int16_t jump_price(float here, float before, int small, int large) {
  const float price = large / (1.f + fabsf(here - before) / 8.f);
  return (int16_t)MAX(price, 1.5f * small);
}

/* The costs of n paths after one more pixel each, added to `total`. `before` and `now` are depths x stride, with a
 * row of FAR before the first and after the last; `low` is the least of `before`, `least` of `now`. */
PART void step(int n, int depths, int stride, int small, const uint8_t *restrict cost,
               const int16_t *restrict before, const int16_t *restrict low, const int16_t *restrict jump,
               int16_t *restrict now, int16_t *restrict least, int16_t *restrict total) {
  for (int x = 0; x < n; x++) least[x] = INT16_MAX;
  for (int d = 0; d < depths; d++) {
    const int16_t *restrict same = before + (size_t)d * stride;
    const int16_t *restrict nearer = same - stride, *restrict farther = same + stride;
    int16_t *restrict here = now + (size_t)d * stride, *restrict sum = total + (size_t)d * n;
    const uint8_t *restrict own = cost + (size_t)d * n;
    for (int x = 0; x < n; x++) {
      const int16_t beside = MIN(nearer[x], farther[x]) + small, near = MIN(same[x], beside) - low[x];
      const int16_t path = MIN(near, jump[x]) + own[x];
      here[x] = path;
      least[x] = MIN(least[x], path);
      sum[x] += path;
    }
  }
}

/* What some paths carry from pixel to pixel: two volumes of one pixel each and their least, in turn. */
typedef struct { int16_t *state[2], *low[2]; int stride, turn; } Paths;

PART size_t paths_size(int n, int depths) { return 2 * (size_t)(n + 2) * (depths + 3); }

PART Paths new_paths(int16_t *memory, int n, int depths) {
  const int stride = n + 2;
  Paths made = {.stride = stride};
  for (int i = 0; i < 2; i++, memory += (size_t)stride * (depths + 3)) {
    memset(memory, 0, sizeof(int16_t) * stride * (depths + 3));
    made.state[i] = memory + stride + 1;
    for (int x = 0; x < stride; x++) memory[x] = memory[(size_t)stride * (depths + 1) + x] = FAR;
    made.low[i] = memory + (size_t)stride * (depths + 2) + 1;
  }
  return made;
}

/* Repeats the columns at the border beyond it: slanting paths go on along the border. */
PART void extend(int16_t *now, int16_t *least, int n, int depths, int stride) {
  for (int d = 0; d < depths; d++, now += stride) now[-1] = now[0], now[n] = now[n - 1];
  least[-1] = least[0], least[n] = least[n - 1];
}

/* One more pixel of n paths that go straight on. */
PART void walk(Paths *paths, int n, int depths, int small, const uint8_t *cost, const int16_t *jump,
               int16_t *total) {
  const int from = paths->turn, to = !from;
  int16_t *now = paths->state[to], *least = paths->low[to];
  step(n, depths, paths->stride, small, cost, paths->state[from], paths->low[from], jump, now, least, total);
  extend(now, least, n, depths, paths->stride);
  paths->turn = to;
}

/* One path's cost after one more pixel: see `step`. */
PART int16_t next_cost(const int16_t *same, int stride, int small, int16_t low, int16_t jump, int16_t own) {
  const int16_t beside = MIN(same[-stride], same[stride]) + small, near = MIN(same[0], beside) - low;
  return MIN(near, jump) + own;
}

/* The paths that come to row y from the row before it, straight and slanting: in one pass over the totals. `jump` has
 * room for three rows. */
PART void walk_down(Paths *paths, int width, int depths, int small, int large, const uint8_t *cost,
                    const float *here, const float *before, int16_t *jump, int16_t *total) {
  const int stride = paths->stride, from = paths->turn, to = !from;
  int16_t *restrict left_jump = jump, *restrict jump_ = jump + width, *restrict right_jump = jump + 2 * width;
  for (int x = 0; x < width; x++) {
    left_jump[x] = jump_price(here[x], before[MIN(x + 1, width - 1)], small, large);
    jump_[x] = jump_price(here[x], before[x], small, large);
    right_jump[x] = jump_price(here[x], before[MAX(x - 1, 0)], small, large);
  }
  const int16_t *restrict left_low = paths[0].low[from] + 1, *restrict low = paths[1].low[from];
  const int16_t *restrict right_low = paths[2].low[from] - 1;
  int16_t *restrict left_least = paths[0].low[to], *restrict least = paths[1].low[to];
  int16_t *restrict right_least = paths[2].low[to];
  for (int x = 0; x < width; x++) left_least[x] = least[x] = right_least[x] = INT16_MAX;
  for (int d = 0; d < depths; d++) {
    const size_t at = (size_t)d * stride;
    const int16_t *left_before = paths[0].state[from] + at + 1, *before_ = paths[1].state[from] + at;
    const int16_t *right_before = paths[2].state[from] + at - 1;
    int16_t *restrict left_now = paths[0].state[to] + at, *restrict now = paths[1].state[to] + at;
    int16_t *restrict right_now = paths[2].state[to] + at, *restrict sum = total + (size_t)d * width;
    const uint8_t *restrict own = cost + (size_t)d * width;
    INDEPENDENT
    for (int x = 0; x < width; x++) {
      const int16_t a = next_cost(left_before + x, stride, small, left_low[x], left_jump[x], own[x]);
      const int16_t b = next_cost(before_ + x, stride, small, low[x], jump_[x], own[x]);
      const int16_t c = next_cost(right_before + x, stride, small, right_low[x], right_jump[x], own[x]);
      left_now[x] = a, now[x] = b, right_now[x] = c;
      left_least[x] = MIN(left_least[x], a), least[x] = MIN(least[x], b), right_least[x] = MIN(right_least[x], c);
      sum[x] += a + b + c;
    }
  }
  for (int i = 0; i < 3; i++) {
    extend(paths[i].state[to], paths[i].low[to], width, depths, stride);
    paths[i].turn = to;
  }
}

/* The paths along some rows, `TURNED` at most, there and back; `side` and `sums` are width x depths x TURNED. */
PART void walk_across(int rows, int width, int depths, int small, int large, const uint8_t *costs,
                      const float *grey, int16_t *memory, uint8_t *side, int16_t *sums, int16_t *total) {
  const size_t column = (size_t)depths * TURNED;
  for (int d = 0; d < depths; d++)
    for (int left = 0; left < width; left += 16)
      for (int r = 0; r < TURNED; r++) {
        const uint8_t *from = costs + ((size_t)MIN(r, rows - 1) * depths + d) * width;
        for (int x = left; x < MIN(left + 16, width); x++) side[x * column + d * TURNED + r] = from[x];
      }
  memset(sums, 0, sizeof(int16_t) * column * width);
  for (int back = 0; back < 2; back++) {
    Paths paths = new_paths(memory, TURNED, depths);
    for (int k = 0; k < width; k++) {
      const int x = back ? width - 1 - k : k, last = MIN(MAX(back ? x + 1 : x - 1, 0), width - 1);
      int16_t jump[TURNED];
      for (int r = 0; r < TURNED; r++) {
        const float *row = grey + (size_t)MIN(r, rows - 1) * width;
        jump[r] = jump_price(row[x], row[last], small, large);
      }
      walk(&paths, TURNED, depths, small, side + x * column, jump, sums + x * column);
    }
  }
  for (int d = 0; d < depths; d++)
    for (int left = 0; left < width; left += 16)
      for (int r = 0; r < rows; r++) {
        int16_t *to = total + ((size_t)r * depths + d) * width;
        for (int x = left; x < MIN(left + 16, width); x++) to[x] += sums[x * column + d * TURNED + r];
      }
}

/* Number of each pixel's cheapest depth, between two by a parabola, and the cost that it has itself. */
PART void choose(int width, int depths, const int16_t *restrict total, const uint8_t *restrict cost,
                 int16_t *restrict best, int16_t *restrict number, float *restrict place, float *restrict own) {
  for (int x = 0; x < width; x++) best[x] = total[x], number[x] = 0;
  for (int d = 1; d < depths; d++) {
    const int16_t *restrict here = total + (size_t)d * width;
    for (int x = 0; x < width; x++) {
      number[x] = here[x] < best[x] ? d : number[x];
      best[x] = MIN(here[x], best[x]);
    }
  }
  for (int x = 0; x < width; x++) {
    const int inner = MIN(MAX(number[x], 1), depths - 2);
    const int16_t *at = total + (size_t)inner * width + x;
    const float b = at[-width], h = at[0], a = at[width], bend = b - 2.f * h + a;
    const float part = 0.5f * (b - a) / MAX(bend, 1.f);
    place[x] = inner + MIN(MAX(part, -0.5f), 0.5f);
    own[x] = cost[(size_t)number[x] * width + x];
  }
}

/* `small`: the price of a step by one depth, `large` of any other. `total` gets the sums of
 * all paths, of the volume's size; without `place` that is all. */
FOR_ALL int cheapest(int height, int width, int depths, const uint8_t *costs, const float *grey, int small,
                     int large, int16_t *total, float *place, float *own) {
  const size_t row = (size_t)depths * width, each = paths_size(width, depths);
  const size_t turned = (size_t)TURNED * row, narrow = paths_size(TURNED, depths);
  int16_t *memory = malloc(sizeof(int16_t) * (3 * each + narrow + 3 * (size_t)width + turned) + turned);
  if (!memory) return 1;
  int16_t *along = memory + 3 * each, *spare = along + narrow, *sums = spare + 3 * width;
  uint8_t *side = (uint8_t *)(sums + turned);
  Paths paths[3];
  for (int i = 0; i < 3; i++) paths[i] = new_paths(memory + i * each, width, depths);
  memset(total, 0, sizeof(int16_t) * row * height);
  for (int y = 0; y < height; y++) {
    const float *here = grey + (size_t)y * width, *before = y ? here - width : here;
    walk_down(paths, width, depths, small, large, costs + y * row, here, before, spare, total + y * row);
  }
  for (int i = 0; i < 3; i++) paths[i] = new_paths(memory + i * each, width, depths);
  for (int bottom = height; bottom > 0; bottom -= TURNED) {
    const int top = MAX(bottom - TURNED, 0);
    const size_t start = (size_t)top * width;
    walk_across(bottom - top, width, depths, small, large, costs + top * row, grey + start, along, side, sums,
                total + top * row);
    for (int y = bottom - 1; y >= top; y--) {
      const size_t at = (size_t)y * width;
      const float *here = grey + at, *before = y < height - 1 ? here + width : here;
      walk_down(paths, width, depths, small, large, costs + y * row, here, before, spare, total + y * row);
      if (place)
        choose(width, depths, total + y * row, costs + y * row, spare, spare + width, place + at, own + at);
    }
  }
  free(memory);
  return 0;
}

/* ---- Planes through each pixel's neighbours, see `fit_planes` ---- */

enum { LANES = 16 }; /* columns at once; `padded` has so many more than its border needs */

/* `planes`: level and slopes per `border` px, each height x width; those before, then those found. `padded`: the
 * levels with a border of radius * stride px. */
FOR_ALL int planes(int height, int width, int radius, int stride, int rounds, float tolerance,
                   const float *padded, float *planes) {
  const int border = radius * stride, wide = width + 2 * border + LANES;
  const size_t size = (size_t)height * width;
  const float share = 1.f / tolerance;
  for (int y = 0; y < height; y++)
    for (int left = 0; left < width; left += LANES) {
      float level[LANES], right[LANES], down[LANES];
      float *at = planes + (size_t)y * width + left;
      const int n = MIN(LANES, width - left);
      for (int i = 0; i < LANES; i++) {
        const int j = MIN(i, n - 1);
        level[i] = at[j], right[i] = at[size + j], down[i] = at[2 * size + j];
      }
      for (int round = 0; round < rounds; round++) {
        float sn[LANES] = {0}, sx[LANES] = {0}, sy[LANES] = {0}, sxx[LANES] = {0}, sxy[LANES] = {0};
        float syy[LANES] = {0}, sv[LANES] = {0}, sxv[LANES] = {0}, syv[LANES] = {0};
        for (int dy = -border; dy <= border; dy += stride)
          for (int dx = -border; dx <= border; dx += stride) {
            const float *near = padded + (size_t)(y + border + dy) * wide + left + border + dx;
            const float x = dx / (float)border, y_ = dy / (float)border;
            for (int i = 0; i < LANES; i++) {
              const float gap = near[i] - level[i], off = (gap - x * right[i] - y_ * down[i]) * share;
              const float close = 1.f - off * off, weight = MAX(close, 0.f), value = weight * gap;
              sn[i] += weight, sx[i] += weight * x, sy[i] += weight * y_;
              sxx[i] += weight * (x * x), sxy[i] += weight * (x * y_), syy[i] += weight * (y_ * y_);
              sv[i] += value, sxv[i] += value * x, syv[i] += value * y_;
            }
          }
        for (int i = 0; i < LANES; i++) {
          const float n_ = MAX(sn[i], 1e-6f), mx = sx[i] / n_, my = sy[i] / n_, mv = sv[i] / n_;
          /* A little of the identity: the slope across an edge is unknown, and taken as flat. */
          const float xx = sxx[i] / n_ - mx * mx + 0.01f, yy = syy[i] / n_ - my * my + 0.01f;
          const float xy = sxy[i] / n_ - mx * my, xv = sxv[i] / n_ - mx * mv, yv = syv[i] / n_ - my * mv;
          const float area = xx * yy - xy * xy, det = MAX(area, 1e-6f);
          const float a = (yy * xv - xy * yv) / det, b = (xx * yv - xy * xv) / det;
          const int enough = n_ > 3.f;
          level[i] = enough ? level[i] + mv - a * mx - b * my : level[i];
          right[i] = enough ? a : right[i], down[i] = enough ? b : down[i];
        }
      }
      for (int i = 0; i < n; i++) at[i] = level[i], at[size + i] = right[i], at[2 * size + i] = down[i];
    }
  return 0;
}

/* ---- Votes: where another view's surface is this one, and where that view could see it ---- */

typedef struct {
  float to[13];                      /* to the other's pixels, as of a source */
  float turn[9], centre[3];          /* the reference's from the other's: rotation, and the other's centre */
  float back_x[2], back_y[2];        /* the other's rays: x' = back_x[0] * x + back_x[1], likewise y' */
  float ray_x[2], ray_y[2], focal;   /* the reference's */
  float relative, sure, pixels, cosine;
} Pair;

/* `other` has a border of one pixel, of 0. All is `restrict`: bytes may alias anything, and a loop that writes them
 * is made of vectors only if it knows that they do not. */
FOR_ALL int votes(int height, int width, const float *restrict surface, int other_height, int other_width,
                  const float *restrict other, const Pair *restrict pair, uint8_t *restrict same,
                  uint8_t *restrict able) {
  const float *m = pair->to, *r = pair->turn, *c = pair->centre;
  for (int y = 0; y < height; y++) {
    const float *levels = surface + (size_t)y * width;
    uint8_t *agrees = same + (size_t)y * width, *sees = able + (size_t)y * width;
    const float u0 = m[1] * y + m[2], v0 = m[4] * y + m[5], z0 = m[7] * y + m[8];
    const float ray_y = pair->ray_y[0] * y + pair->ray_y[1];
    for (int x = 0; x < width; x++) {
      const float level = levels[x], z = m[6] * x + z0 + m[11] * level, far = 1.f / MAX(z, 1e-6f);
      const float u = (m[0] * x + u0 + m[9] * level) * far, v = (m[3] * x + v0 + m[10] * level) * far;
      /* From the border's corner on nothing is negative: adding a half and cutting off rounds. */
      const int column = (int)(at_most(at_least(u, -1.f), other_width) + 1.5f);
      const int row = (int)(at_most(at_least(v, -1.f), other_height) + 1.5f);
      const float found = other[row * (other_width + 2) + column], seen = found * (z > 1e-6f);
      const float expected = level * far, off = fabsf(seen - expected);
      /* How many px of the reference the other's depth is worth there. */
      const float px = pair->back_x[0] * u + pair->back_x[1], py = pair->back_y[0] * v + pair->back_y[1];
      const float along = r[6] * px + r[7] * py + r[8], per = 1.f / MAX(fabsf(along), 1e-3f);
      const float right = c[0] - (r[0] * px + r[1] * py + r[2]) * per * c[2];
      const float down = c[1] - (r[3] * px + r[4] * py + r[5]) * per * c[2];
      const float moved = off * pair->focal * sqrtf(right * right + down * down) * per;
      /* The angle between the two views' rays. */
      const float ray_x = pair->ray_x[0] * x + pair->ray_x[1];
      const float ox = ray_x - c[0] * level, oy = ray_y - c[1] * level, oz = 1.f - c[2] * level;
      const float own = ray_x * ray_x + ray_y * ray_y + 1.f, others = ox * ox + oy * oy + oz * oz;
      const int alike = ray_x * ox + ray_y * oy + oz > pair->cosine * sqrtf(own * others);
      const int near = (off < pair->relative * seen) & ((off < pair->sure * seen) | (moved < pair->pixels));
      agrees[x] = (seen > 0.f) & near & alike;
      sees[x] = (seen > 0.f) & (seen <= expected * (1.f + pair->relative)) & alike;
    }
  }
  return 0;
}

/* ---- Fusion of depth maps into points, see `fusion.py` ---- */

typedef struct {
  const float *depth, *normals;     /* height x width, the normals x 3 */
  const uint8_t *colours;           /* height x width x 3, blue first */
  uint8_t *taken;                   /* pixels that have joined a point */
  int width, height;
  float onto[12];                   /* 3x3 from the rig to homogeneous pixels, then what is added */
  float back[9], centre[3], turn[9]; /* 3x3 from pixels to rays of the rig, their start, and the rotation */
} Map;

/* Place, normal and colour that a map has at a pixel. */
PART void measure(const Map *map, size_t at, float *out) {
  const float x = at % map->width, y = at / map->width, depth = map->depth[at], *n = map->normals + 3 * at;
  const float *back = map->back, *turn = map->turn;
  for (int i = 0; i < 3; i++) {
    out[i] = (x * back[i] + y * back[3 + i] + back[6 + i]) * depth + map->centre[i];
    out[3 + i] = n[0] * turn[i] + n[1] * turn[3 + i] + n[2] * turn[6 + i];
    out[6 + i] = map->colours[3 * at + 2 - i];
  }
}

/* Starts points at the free pixels of each map in turn. The first point that a later map shows at a pixel, with about
 * the same depth and normal, takes that pixel. Points of at least `required` maps are means of their pixels. */
int fuse(int count, const Map *maps, int required, float error, float cosine, float *points, uint8_t *seen,
         int64_t *found) {
  int64_t n = 0;
  for (int place = 0; place < MIN(count, MAX(1, count + 1 - required)); place++) {
    const Map *own = maps + place;
    const size_t size = (size_t)own->width * own->height;
    for (size_t start = 0; start < size; start++) {
      if (!(own->depth[start] > 0.f) || own->taken[start]) continue;
      float first[9], *total = points + 9 * n;
      uint8_t *showing = seen + n * count;
      int together = 1;
      measure(own, start, first);
      memcpy(total, first, sizeof first);
      memset(showing, 0, count);
      showing[place] = 1;
      for (int later = place + 1; later < count; later++) {
        const Map *other = maps + later;
        const float *m = other->onto, *p = first;
        const float z = m[6] * p[0] + m[7] * p[1] + m[8] * p[2] + m[11], far = 1.f / z;
        const float u = rintf((m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[9]) * far);
        const float v = rintf((m[3] * p[0] + m[4] * p[1] + m[5] * p[2] + m[10]) * far);
        if (!(z > 1e-6f && u >= 0.f && u < other->width && v >= 0.f && v < other->height)) continue;
        const size_t at = (size_t)v * other->width + (size_t)u;
        const float depth = other->depth[at];
        if (!(depth > 0.f) || other->taken[at] || fabsf(z - depth) > error * depth) continue;
        float theirs[9];
        measure(other, at, theirs);
        if (!(theirs[3] * first[3] + theirs[4] * first[4] + theirs[5] * first[5] >= cosine)) continue;
        for (int i = 0; i < 9; i++) total[i] += theirs[i];
        other->taken[at] = showing[later] = 1;
        together++;
      }
      if (together < required) continue;
      for (int i = 0; i < 9; i++) total[i] /= together;
      n++;
    }
  }
  *found = n;
  return 0;
}

/* ---- Points that views deny, see `fusion.py` ---- */

/* The least depth at a pixel and its neighbours. */
PART float nearest_depth(const Map *map, int column, int row) {
  float least = INFINITY;
  for (int y = MAX(row - 1, 0); y <= MIN(row + 1, map->height - 1); y++)
    for (int x = MAX(column - 1, 0); x <= MIN(column + 1, map->width - 1); x++)
      least = at_most(map->depth[(size_t)y * map->width + x], least);
  return least;
}

/* Whether each of n points with these normals (n x 3) is denied by over half as many maps as confirm it. */
int deny(int count, const Map *maps, int64_t n, const float *points, const float *normals, float slack, float behind,
         uint8_t *denied) {
  for (int64_t i = 0; i < n; i++) {
    const float *p = points + 3 * i, *normal = normals + 3 * i;
    int confirming = 0, denying = 0;
    for (int k = 0; k < count; k++) {
      const Map *map = maps + k;
      const float *m = map->onto, *c = map->centre;
      const float z = m[6] * p[0] + m[7] * p[1] + m[8] * p[2] + m[11], far = 1.f / z;
      const float u = rintf((m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[9]) * far);
      const float v = rintf((m[3] * p[0] + m[4] * p[1] + m[5] * p[2] + m[10]) * far);
      if (!(z > 1e-6f && u >= 0.f && u < map->width && v >= 0.f && v < map->height)) continue;
      const float x = c[0] - p[0], y = c[1] - p[1], w = c[2] - p[2];
      const float cosine = (x * normal[0] + y * normal[1] + w * normal[2]) / sqrtf(x * x + y * y + w * w);
      const float depth = map->depth[(size_t)v * map->width + (size_t)u];
      confirming += cosine > 0.f && fabsf(depth - z) < slack * z;
      denying += nearest_depth(map, (int)u, (int)v) > (cosine < behind ? 1.f - slack : 1.f + slack) * z;
    }
    denied[i] = denying > 0 && confirming <= 2 * denying;
  }
  return 0;
}

/* ---- Pixels beside edges of depth, see `methods/multiview/edge_sharpening.py` ---- */

/* A plane's level (of 3 x height x width) at a pixel, from a pixel beside it; the border's planes go on beyond it. */
PART float level_beside(int height, int width, const float *planes, int x, int y, int dx, int dy, size_t *at) {
  const size_t size = (size_t)height * width;
  const int column = MIN(MAX(x + dx, 0), width - 1), row = MIN(MAX(y + dy, 0), height - 1);
  *at = (size_t)row * width + column;
  return planes[*at] - planes[size + *at] * (column - x) - planes[2 * size + *at] * (row - y);
}

/* The nearest level around each of n pixels, and the farthest plane (3 x n), both extended to the pixel. */
int edge_sides(int height, int width, const float *planes, int64_t n, const int32_t *pixels, int reach, float *near,
               float *far) {
  const size_t size = (size_t)height * width;
  for (int64_t i = 0; i < n; i++) {
    const int x = pixels[i] % width, y = pixels[i] / width;
    size_t at, farthest = pixels[i];
    near[i] = far[i] = planes[farthest];
    for (int off = reach; off >= reach / 2; off -= reach - reach / 2)
      for (int k = 0; k < 9; k++) {
        const float level = level_beside(height, width, planes, x, y, (k % 3 - 1) * off, (k / 3 - 1) * off, &at);
        near[i] = at_least(level, near[i]);
        if (level < far[i]) far[i] = level, farthest = at;
      }
    far[n + i] = planes[size + farthest], far[2 * n + i] = planes[2 * size + farthest];
  }
  return 0;
}

/* Sums over each of n pixels' neighbours, weighted by likeness of colour and place: of those farther than `between`, of
 * the others, and of gains above zero and of all where there are gains (4 x n). `alike` is a neighbour's weight by its
 * distance in x and y, (reach / 2 + 1)^2 of them, then by the sum of its colour's differences. */
int weigh_sides(int height, int width, const float *level, const float *gain, const uint8_t *colours, int64_t n,
                const int32_t *pixels, const float *between, int reach, const float *alike, float *sums) {
  const int across = reach / 2 + 1;
  const float *alike_colour = alike + across * across;
  for (int64_t i = 0; i < n; i++) {
    const int x = pixels[i] % width, y = pixels[i] / width;
    const uint8_t *own = colours + 3 * (size_t)pixels[i];
    float farther = 0.f, nearer = 0.f, gained = 0.f, judged = 0.f;
    for (int row = MAX(y - reach, y % 2); row <= MIN(y + reach, height - 1); row += 2)
      for (int column = MAX(x - reach, x % 2); column <= MIN(x + reach, width - 1); column += 2) {
        const size_t at = (size_t)row * width + column;
        const uint8_t *colour = colours + 3 * at;
        const int apart = abs(colour[0] - own[0]) + abs(colour[1] - own[1]) + abs(colour[2] - own[2]);
        const float weight = alike[abs(row - y) / 2 * across + abs(column - x) / 2] * alike_colour[apart];
        if (level[at] < between[i]) farther += weight;
        else nearer += weight;
        gained += weight * at_least(gain[at], 0.f), judged += weight * (gain[at] != 0.f);
      }
    sums[i] = farther, sums[n + i] = nearer, sums[2 * n + i] = gained, sums[3 * n + i] = judged;
  }
  return 0;
}

/* ---- Neighbours on a pixel's surface, see `geometric_consistency.py` ---- */

/* How many of each second pixel within `radius` px of n pixels are on its plane (planes: 3 x height x width), and how
 * many of these are `valid`. */
int support(int height, int width, const float *planes, const uint8_t *valid, int64_t n, const int32_t *pixels,
            int radius, float relative, int32_t *places, int32_t *there) {
  const size_t size = (size_t)height * width;
  for (int64_t i = 0; i < n; i++) {
    const int x = pixels[i] % width, y = pixels[i] / width;
    const float level = planes[pixels[i]], right = planes[size + pixels[i]], down = planes[2 * size + pixels[i]];
    int on = 0, good = 0;
    for (int dy = -radius; dy <= radius; dy += 2)
      for (int dx = -radius; dx <= radius; dx += 2) {
        if (x + dx < 0 || x + dx >= width || y + dy < 0 || y + dy >= height) continue;
        const size_t at = (size_t)(y + dy) * width + x + dx;
        const int near = fabsf(planes[at] - level - right * dx - down * dy) < relative * level;
        on += near, good += near & valid[at];
      }
    places[i] = on, there[i] = good;
  }
  return 0;
}

/* ---- Planes that match as well as others, see `methods/multiview/blank_walls.py` ---- */

/* Marks the places where a level (`count` of `size`) is within a relative distance of one before it but the first. */
FOR_ALL int repeats(int count, int size, const float *levels, float relative, uint8_t *marked) {
  for (int k = 2; k < count; k++)
    for (int j = 1; j < k; j++) {
      const float *restrict level = levels + (size_t)k * size, *restrict other = levels + (size_t)j * size;
      uint8_t *restrict mark = marked + (size_t)k * size;
      for (int i = 0; i < size; i++) mark[i] |= fabsf(level[i] - other[i]) < relative * other[i];
    }
  return 0;
}

/* ---- Points near others, see `instant_scoring.py` ---- */

/* The cell of a point, of a grid of cubes with this side, in a table of a power of two of cells. */
PART size_t cell_of(const float *point, float side, int dx, int dy, int dz, size_t cells) {
  const int64_t x = (int64_t)floorf(point[0] / side) + dx, y = (int64_t)floorf(point[1] / side) + dy;
  const int64_t z = (int64_t)floorf(point[2] / side) + dz;
  return ((uint64_t)x * 73856093u ^ (uint64_t)y * 19349663u ^ (uint64_t)z * 83492791u) & (cells - 1);
}

/* Which of m asked points (m x 3) have one of the n points within a distance. */
int near(int64_t n, const float *points, int64_t m, const float *asked, float distance, uint8_t *found) {
  size_t cells = 1024;
  while (cells < (size_t)n) cells *= 2;
  int64_t *first = malloc(sizeof(int64_t) * (cells + n)), *next = first + cells;
  if (!first) return 1;
  for (size_t i = 0; i < cells; i++) first[i] = -1;
  for (int64_t i = 0; i < n; i++) {
    const size_t cell = cell_of(points + 3 * i, distance, 0, 0, 0, cells);
    next[i] = first[cell], first[cell] = i;
  }
  for (int64_t k = 0; k < m; k++) {
    const float *p = asked + 3 * k;
    found[k] = 0;
    for (int c = 0; c < 27 && !found[k]; c++)
      for (int64_t i = first[cell_of(p, distance, c % 3 - 1, c / 3 % 3 - 1, c / 9 - 1, cells)]; i >= 0; i = next[i]) {
        const float x = points[3 * i] - p[0], y = points[3 * i + 1] - p[1], z = points[3 * i + 2] - p[2];
        if (x * x + y * y + z * z <= distance * distance) {
          found[k] = 1;
          break;
        }
      }
  }
  free(first);
  return 0;
}
