/* New views of a moment from depth maps, for the processor; `view_blending.py` calls them.
 *
 * Images are height x width, pixels' centres at whole numbers. Functions return 0. */
#include <math.h>
#include <stdint.h>

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

/* ---- The surface that a new view sees ---- */

/* Depth of a map as the new view sees it: every pixel is drawn as a square of its size, the nearest stays.
 * `to`: 3x3 from the map's pixels times depth, then the shift (3); `zoom`: new focal length over the map's.
 * `out`: height x width, set to 0 where there is nothing. */
int nearest_depth(int map_height, int map_width, const float *depth, const float *to, float zoom, int height,
                  int width, float *out) {
  for (long i = 0; i < (long)height * width; i++) out[i] = 0.f;
  for (int y = 0; y < map_height; y++)
    for (int x = 0; x < map_width; x++) {
      const float d = depth[(long)y * map_width + x];
      if (d <= 0.f) continue;
      const float z = (to[6] * x + to[7] * y + to[8]) * d + to[11];
      if (z < 1e-6f) continue;
      const float u = ((to[0] * x + to[1] * y + to[2]) * d + to[9]) / z;
      const float v = ((to[3] * x + to[4] * y + to[5]) * d + to[10]) / z;
      /* Half a pixel more than its size, so that neighbours leave no gap where the surface is slanted. */
      const float half = 0.5f + 0.5f * MIN(zoom * d / z, 8.f);
      if (u < -half || v < -half || u > width + half || v > height + half) continue;
      const int left = MAX((int)ceilf(u - half), 0), right = MIN((int)floorf(u + half), width - 1);
      const int top = MAX((int)ceilf(v - half), 0), bottom = MIN((int)floorf(v + half), height - 1);
      for (int row = top; row <= bottom; row++)
        for (int column = left; column <= right; column++) {
          float *there = out + (long)row * width + column;
          if (*there == 0.f || z < *there) *there = z;
        }
    }
  return 0;
}

enum { MAX_VIEWS = 64 };

/* The nearest of several maps' depths that another one confirms, and the mean of those that agree with it; without
 * one, the nearest that any map has. `layers`: count x height x width, `weight`: how much each map counts. */
int agreed_depth(int count, long pixels, const float *layers, const float *weight, float tolerance, float *out) {
  if (count > MAX_VIEWS) return 1;
  for (long i = 0; i < pixels; i++) {
    float nearest = 0.f, best = 0.f, sum = 0.f, total = 0.f;
    for (int a = 0; a < count; a++) {
      const float z = layers[a * pixels + i];
      if (z <= 0.f) continue;
      if (nearest == 0.f || z < nearest) nearest = z;
      if (best != 0.f && z >= best) continue;
      for (int b = 0; b < count; b++)
        if (b != a && fabsf(layers[b * pixels + i] - z) < tolerance * z) {
          best = z;
          break;
        }
    }
    if (best == 0.f) {
      out[i] = nearest;
      continue;
    }
    for (int a = 0; a < count; a++) {
      const float z = layers[a * pixels + i];
      if (fabsf(z - best) < tolerance * best) sum += weight[a] * z, total += weight[a];
    }
    out[i] = total > 0.f ? sum / total : best;
  }
  return 0;
}

/* ---- Its colours ---- */

typedef struct {
  const uint8_t *colours; /* height x width x 3 */
  const float *depth;     /* height x width, 0 = unknown */
  int width, height;
  float to[12];    /* 3x3 from the new view's pixels times depth to the source's, then the shift (3) */
  float centre[3]; /* of the source, in the new view's frame */
} SeenFrom;

static inline void cubic(float t, float *w) {
  const float a = -0.5f; /* Catmull-Rom: it keeps a ramp */
  w[0] = ((a * t - 2 * a) * t + a) * t;
  w[1] = ((a + 2) * t - (a + 3)) * t * t + 1;
  w[2] = ((-(a + 2) * t + (2 * a + 3)) * t - a) * t;
  w[3] = (-a * t + a) * t * t;
}

static void sample(const SeenFrom *source, float u, float v, float *out) {
  const int x = (int)floorf(u), y = (int)floorf(v);
  float across[4], down[4];
  cubic(u - x, across);
  cubic(v - y, down);
  out[0] = out[1] = out[2] = 0.f;
  for (int j = 0; j < 4; j++) {
    const int row = MIN(MAX(y - 1 + j, 0), source->height - 1);
    for (int i = 0; i < 4; i++) {
      const int column = MIN(MAX(x - 1 + i, 0), source->width - 1);
      const uint8_t *p = source->colours + 3 * ((long)row * source->width + column);
      const float w = across[i] * down[j];
      out[0] += w * p[0], out[1] += w * p[1], out[2] += w * p[2];
    }
  }
}

/* Rows `top` to `bottom` of the new view: colours of the sources that see its surface, by weight. A source counts
 * more the nearer its direction is to the view's; little where its own map has no depth there; not at all where
 * something hides the surface from it. `rays`: focal lengths and principal point. `weights` (height x width): 0
 * where no source sees the surface, or there is none. */
int blend_views(int count, const SeenFrom *sources, int width, int top, int bottom, const float *depth,
                const float *rays, float tolerance, float sharpness, float unsure, float *out, float *weights) {
  for (int y = top; y < bottom; y++)
    for (int x = 0; x < width; x++) {
      const long i = (long)y * width + x;
      const float d = depth[i];
      float *colour = out + 3 * i, total = 0.f;
      colour[0] = colour[1] = colour[2] = 0.f;
      weights[i] = 0.f;
      if (d <= 0.f) continue;
      const float point[3] = {(x - rays[2]) / rays[0] * d, (y - rays[3]) / rays[1] * d, d};
      const float range = sqrtf(point[0] * point[0] + point[1] * point[1] + d * d);
      for (int s = 0; s < count; s++) {
        const SeenFrom *source = sources + s;
        const float *m = source->to;
        const float z = (m[6] * x + m[7] * y + m[8]) * d + m[11];
        if (z < 1e-6f) continue;
        const float u = ((m[0] * x + m[1] * y + m[2]) * d + m[9]) / z;
        const float v = ((m[3] * x + m[4] * y + m[5]) * d + m[10]) / z;
        if (!(u >= 0.f && v >= 0.f && u <= source->width - 1 && v <= source->height - 1)) continue;
        const float there = source->depth[(long)(v + .5f) * source->width + (long)(u + .5f)];
        float w = fabsf(there - z) < tolerance * z ? 1.f : unsure;
        if (there > 0.f && there < (1.f - tolerance) * z) continue; /* hidden */
        float to_source[3], away = 0.f, dot = 0.f;
        for (int k = 0; k < 3; k++) {
          to_source[k] = point[k] - source->centre[k];
          away += to_source[k] * to_source[k];
          dot += to_source[k] * point[k];
        }
        const float cosine = MIN(dot / (range * sqrtf(away)), 1.f);
        const float angle = 2.f * (1.f - cosine) * sharpness; /* the angle's square over the scale's square */
        w *= expf(-MIN(angle, 30.f)) + 1e-6f / (1.f + angle);
        float seen[3];
        sample(source, u, v, seen);
        for (int k = 0; k < 3; k++) colour[k] += w * seen[k];
        total += w;
      }
      if (total <= 0.f) continue;
      for (int k = 0; k < 3; k++) colour[k] /= total;
      weights[i] = total;
    }
  return 0;
}
