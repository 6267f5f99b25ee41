/* Rendering of oriented Gaussians, and its gradients, for the processor; `gaussians.py` calls them.
 *
 * After EWA splatting (Zwicker et al. 2001) and 3D Gaussian Splatting (Kerbl et al. 2023), front to back. Positions
 * and axes stay as they are; colours, opacities and sizes have gradients. Functions return 0. */
#include <math.h>
#include <stdint.h>

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

/* Variance, px squared, that every Gaussian has at least in the picture; radius in standard deviations; opacity below
 * which a pixel is not touched; transmittance at which a pixel is full. */
static const float BLUR = 0.3f, RADII = 3.f, FAINT = 1.f / 255, FULL = 1e-3f, MOST = 0.99f;
enum { NUMBERS = 7 }; /* of a projected Gaussian: its pixel, its conic, its half width and height */
enum { AHEAD = 16 };  /* Gaussians that are fetched before their turn */

/* Gaussians `first` to `last` in a view: `pose` is 3x3 and the shift, `lens` fx, fy, cx, cy; `axes` (n x 3 x 3) has
 * unit vectors as columns, `sizes` (n x 3) standard deviations along them, times exp(`grown`, n). `flat` gets
 * NUMBERS each, a half width of -1 where the view does not see it; `depths` (n) the depth. */
int project_gaussians(int first, int last, const float *places, const float *axes, const float *sizes,
                      const float *grown, const float *pose, const float *lens, int width, int height, float *flat,
                      float *depths) {
  for (long g = first; g < last; g++) {
    float at[3], *out = flat + NUMBERS * g;
    for (int i = 0; i < 3; i++)
      at[i] = pose[3 * i] * places[3 * g] + pose[3 * i + 1] * places[3 * g + 1] + pose[3 * i + 2] * places[3 * g + 2] +
              pose[9 + i];
    const float z = at[2];
    depths[g] = z;
    out[5] = -1.f;
    if (z < 1e-6f) continue;
    const float x = at[0] / z, y = at[1] / z, scale = expf(grown[g]);
    float a = BLUR, b = 0.f, c = BLUR;
    for (int k = 0; k < 3; k++) {
      float axis[3];
      for (int i = 0; i < 3; i++)
        axis[i] = (pose[3 * i] * axes[9 * g + k] + pose[3 * i + 1] * axes[9 * g + 3 + k] +
                   pose[3 * i + 2] * axes[9 * g + 6 + k]) *
                  sizes[3 * g + k] * scale;
      const float u = lens[0] * (axis[0] - x * axis[2]) / z, v = lens[1] * (axis[1] - y * axis[2]) / z;
      a += u * u, b += u * v, c += v * v;
    }
    const float left = lens[0] * x + lens[2], top = lens[1] * y + lens[3];
    const float across = RADII * sqrtf(a), down = RADII * sqrtf(c), determinant = a * c - b * b;
    if (!(left > -across && top > -down && left < width + across && top < height + down)) continue;
    if (across > 0.25f * width || determinant <= 0.f) continue; /* beside the camera, its picture is no ellipse */
    out[0] = left, out[1] = top;
    out[2] = c / determinant, out[3] = -b / determinant, out[4] = a / determinant;
    out[5] = across, out[6] = down;
  }
  return 0;
}

typedef struct {
  int left, right, top, bottom;
} Box;

static inline Box box_of(const float *flat, int width, int top, int bottom) {
  const Box box = {MAX((int)ceilf(flat[0] - flat[5]), 0), MIN((int)floorf(flat[0] + flat[5]), width - 1),
                   MAX((int)ceilf(flat[1] - flat[6]), top), MIN((int)floorf(flat[1] + flat[6]), bottom - 1)};
  return box;
}

/* Begins to read a Gaussian: neighbours in depth are far apart in memory, and waiting took a tenth of the time. */
static inline void fetch(long g, const float *flat, const float *colours) {
  __builtin_prefetch(flat + NUMBERS * g);
  __builtin_prefetch(colours + 3 * g);
}

/* exp(-x / 2) for x from 0 to 9, within 1e-4 of it: half of the time goes here. */
static inline float bell(float x) {
  const float t = 1.f - x * (1.f / 64); /* (1 - x/64)^32 -> exp(-x/2) */
  const float t2 = t * t, t4 = t2 * t2, t8 = t4 * t4, t16 = t8 * t8, t32 = t16 * t16;
  return t32 * (1.f + x * x * (1.f / 256));
}

/* Rows `top` to `bottom`: Gaussians in the order of their depth over black, and what light passes all of them. */
int draw_gaussians(int count, const int32_t *order, const float *flat, const float *opacities, const float *colours,
                   int width, int top, int bottom, float *picture, float *passes) {
  for (long i = (long)top * width; i < (long)bottom * width; i++)
    passes[i] = 1.f, picture[3 * i] = picture[3 * i + 1] = picture[3 * i + 2] = 0.f;
  for (int k = 0; k < count; k++) {
    const long g = order[k];
    if (k + AHEAD < count) fetch(order[k + AHEAD], flat, colours);
    const float *f = flat + NUMBERS * g, *colour = colours + 3 * g, opacity = opacities[g];
    if (f[5] < 0.f || opacity < FAINT) continue;
    const Box box = box_of(f, width, top, bottom);
    for (int y = box.top; y <= box.bottom; y++) {
      const float dy = y - f[1];
      for (int x = box.left; x <= box.right; x++) {
        const long p = (long)y * width + x;
        const float t = passes[p], dx = x - f[0];
        if (t < FULL) continue;
        const float q = f[2] * dx * dx + 2 * f[3] * dx * dy + f[4] * dy * dy;
        if (q > RADII * RADII) continue;
        const float alpha = MIN(opacity * bell(q), MOST);
        if (alpha < FAINT) continue;
        const float w = alpha * t;
        for (int j = 0; j < 3; j++) picture[3 * p + j] += w * colour[j];
        passes[p] = t * (1 - alpha);
      }
    }
  }
  return 0;
}

/* Gradients by colour (n x 3), opacity (n) and `grown` (n), added to what is there. `slopes`: the loss by each of the
 * picture's colours; `drawn`: the picture with its background; `behind`, `passes`: work space, a number a pixel. */
int gaussian_gradients(int count, const int32_t *order, const float *flat, const float *opacities,
                       const float *colours, int width, int top, int bottom, const float *drawn, const float *slopes,
                       float *behind, float *passes, float *by_colour, float *by_opacity, float *by_grown) {
  for (long i = (long)top * width; i < (long)bottom * width; i++) {
    const float *s = slopes + 3 * i, *d = drawn + 3 * i;
    passes[i] = 1.f, behind[i] = s[0] * d[0] + s[1] * d[1] + s[2] * d[2];
  }
  for (int k = 0; k < count; k++) {
    const long g = order[k];
    if (k + AHEAD < count) fetch(order[k + AHEAD], flat, colours);
    const float *f = flat + NUMBERS * g, *colour = colours + 3 * g, opacity = opacities[g];
    if (f[5] < 0.f || opacity < FAINT) continue;
    const Box box = box_of(f, width, top, bottom);
    float colour_slope[3] = {0.f, 0.f, 0.f}, opacity_slope = 0.f, size_slope = 0.f;
    for (int y = box.top; y <= box.bottom; y++) {
      const float dy = y - f[1];
      for (int x = box.left; x <= box.right; x++) {
        const long p = (long)y * width + x;
        const float t = passes[p], dx = x - f[0];
        if (t < FULL) continue;
        const float q = f[2] * dx * dx + 2 * f[3] * dx * dy + f[4] * dy * dy;
        if (q > RADII * RADII) continue;
        const float shape = bell(q), full = opacity * shape, alpha = MIN(full, MOST);
        if (alpha < FAINT) continue;
        const float w = alpha * t, *s = slopes + 3 * p;
        const float by_light = s[0] * colour[0] + s[1] * colour[1] + s[2] * colour[2];
        for (int j = 0; j < 3; j++) colour_slope[j] += w * s[j];
        behind[p] -= w * by_light;
        const float by_alpha = t * by_light - behind[p] / (1 - alpha);
        if (full < MOST) {
          const float across = f[2] * dx + f[3] * dy, down = f[3] * dx + f[4] * dy;
          opacity_slope += by_alpha * shape;
          size_slope += by_alpha * alpha * (q - BLUR * (across * across + down * down));
        }
        passes[p] = t * (1 - alpha);
      }
    }
    for (int j = 0; j < 3; j++) by_colour[3 * g + j] += colour_slope[j];
    by_opacity[g] += opacity_slope;
    by_grown[g] += size_slope;
  }
  return 0;
}

/* A step of Adam (Kingma and Ba 2015) on values `first` to `last`, whose gradients are the sum of `parts` arrays of
 * `stride` values each, which become 0. `rate` includes the corrections of the first steps. */
int adam_step(long first, long last, int parts, long stride, float *slopes, float rate, float root, float low,
              float high, float *mean, float *square, float *values) {
  for (long i = first; i < last; i++) {
    float slope = 0.f;
    for (int p = 0; p < parts; p++) slope += slopes[p * stride + i], slopes[p * stride + i] = 0.f;
    mean[i] = 0.9f * mean[i] + 0.1f * slope;
    square[i] = 0.99f * square[i] + 0.01f * slope * slope;
    values[i] = MIN(MAX(values[i] - rate * mean[i] / (sqrtf(square[i]) * root + 1e-8f), low), high);
  }
  return 0;
}
