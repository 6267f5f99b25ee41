/* The kernels on numbers of chance: prints a hash of what each gives, which is the same on every machine. */
#include "kernels.c"

#include <stdio.h>

enum { H = 97, W = 131, D = 24, N = 3, BORDER = 4 };

static unsigned state = 1;

static float chance(void) {
  state = state * 1664525u + 1013904223u;
  return (state >> 8) / 16777216.f;
}

static void tell(const char *name, const void *data, size_t size) {
  unsigned long long hash = 1469598103934665603ull;
  for (size_t i = 0; i < size; i++) hash = (hash ^ ((const unsigned char *)data)[i]) * 1099511628211ull;
  printf("%s %016llx\n", name, hash);
}

int main(void) {
  static float grey[H * W], mean[H * W], deviation[H * W], base[H * W], pictures[N][(H + 3) * (W + 3)];
  static float out[H * W], place[H * W], own[H * W], found[3 * H * W], offsets[D];
  static float padded[(H + 2 * BORDER) * (W + 2 * BORDER + LANES)];
  static uint8_t volume[H * D * W], same[H * W], able[H * W];
  static int16_t total[H * D * W];
  Source sources[N];
  for (int i = 0; i < H * W; i++) {
    grey[i] = 255 * chance(), mean[i] = 100 + 50 * chance();
    deviation[i] = 20 + 30 * chance(), found[i] = base[i] = .3f + .2f * chance();
  }
  for (int n = 0; n < N; n++) {
    for (int i = 0; i < (H + 3) * (W + 3); i++) pictures[n][i] = i < W + 3 ? -1000.f : 255 * chance();
    sources[n] = (Source){pictures[n], W, H, {1, .01f, .3f * n, -.01f, 1, .5f, 1e-5f, 2e-5f, 1, 20.f * (n - 1), 5.f * n, .05f, 9}};
  }
  for (int d = 0; d < D; d++) offsets[d] = .01f * d;
  for (int half = 2; half < 5; half++)
    for (int count = 1; count <= N; count++) {
      costs(H, W, D, half, count, grey, mean, deviation, count & 1 ? base : 0, offsets, sources, .65f, volume);
      tell("costs", volume, sizeof volume);
    }
  cheapest(H, W, D, volume, grey, 20, 800, total, place, own);
  tell("scan", total, sizeof total);
  tell("place", place, sizeof place);
  tell("own", own, sizeof own);
  warp(H, W, base, sources + 1, out);
  tell("warp", out, sizeof out);
  const int wide = W + 2 * BORDER + LANES;
  for (int y = 0; y < H + 2 * BORDER; y++)
    for (int x = 0; x < wide; x++) {
      const int row = y - BORDER, column = x - BORDER;
      const int inside = row >= 0 && row < H && column >= 0 && column < W;
      padded[y * wide + x] = inside ? base[row * W + column] : -1e6f;
    }
  planes(H, W, 2, 2, 3, .1f, padded, found);
  tell("planes", found, sizeof found);
  const Pair pair = {{1, .01f, .3f, -.01f, 1, .5f, 1e-5f, 2e-5f, 1, 20.f, 5.f, .05f, 9}, {1, 0, 0, 0, 1, 0, 0, 0, 1},
                     {.2f, .01f, 0}, {.01f, -.6f}, {.01f, -.5f}, {.01f, -.6f}, {.01f, -.5f}, 110, .2f, .1f, 3, .7f};
  static float bordered[(H + 2) * (W + 2)];
  for (int y = 0; y < H; y++) memcpy(bordered + (y + 1) * (W + 2) + 1, place + y * W, sizeof(float) * W);
  votes(H, W, base, H, W, bordered, &pair, same, able);
  tell("same", same, sizeof same);
  tell("able", able, sizeof able);
  return 0;
}
