// GPU kernels of the sweep: matching costs, their semi-global scan, and the cheapest depths.
// Costs and totals are height x width x P, of which the first n depths are valid; P is a multiple of 4.
// Compile-time constants: R, half a window; LV, the depths per lane of a path (a multiple of 4).
// Without fused multiply-add (--fmad=false) every machine gives the same costs.

#define TILE_X 32
#define TILE_Y 8
#define WIDE (TILE_X + 2 * R)
#define CELLS (WIDE * (TILE_Y + 2 * R))
#define DEPTHS 16
#define INF (1 << 20)

// Bilinear sample of a source at u, v; pixels beside the image are `outside`.
__device__ float sample(const float* picture, int w, int h, float u, float v, float outside) {
  if (!(u > -1.f && v > -1.f && u < (float)w && v < (float)h)) return outside;
  const float left = floorf(u), top = floorf(v);
  const int x = (int)left, y = (int)top;
  const float right = u - left, down = v - top;
  const bool l = x >= 0, r = x + 1 < w, t = y >= 0, b = y + 1 < h;
  const float* at = picture + (long long)y * w + x;
  const float tl = l && t ? at[0] : outside, tr = r && t ? at[1] : outside;
  const float bl = l && b ? at[w] : outside, br = r && b ? at[w + 1] : outside;
  const float above = tl + (tr - tl) * right, below = bl + (br - bl) * right;
  return above + (below - above) * down;
}

// Costs of a tile of the reference at 16 depths. Each source has 13 numbers: its 3x3 map from the reference's
// pixels, the shift with inverse depth, and its noise. `info` has its first pixel's index, width and height.
extern "C" __global__ void costs(const float* grey, const float* mean, const float* deviation,
                                 const float* base, const float* offsets, int n,
                                 const float* sources, const int* info, const float* numbers, int count,
                                 int H, int W, int P, float outside, float better,
                                 unsigned char* out) {
  __shared__ float warped[CELLS], shown[CELLS], near_[CELLS];
  __shared__ int xs[CELLS], ys[CELLS];
  const int id = threadIdx.y * TILE_X + threadIdx.x;
  const int x0 = blockIdx.x * TILE_X, y0 = blockIdx.y * TILE_Y;
  const int x = x0 + threadIdx.x, y = y0 + threadIdx.y;
  for (int i = id; i < CELLS; i += TILE_X * TILE_Y) {
    // Mirrored at the borders.
    int xx = abs(x0 + i % WIDE - R), yy = abs(y0 + i / WIDE - R);
    if (xx >= W) xx = max(2 * W - 2 - xx, 0);
    if (yy >= H) yy = max(2 * H - 2 - yy, 0);
    xs[i] = xx; ys[i] = yy;
    shown[i] = grey[yy * W + xx];
    near_[i] = base[yy * W + xx];
  }
  const bool inside = x < W && y < H;
  const float mine = inside ? mean[y * W + x] : 0.f, spread = inside ? deviation[y * W + x] : 1.f;
  const float part = 1.f / ((2 * R + 1) * (2 * R + 1));
  const int last = min((int)(blockIdx.z + 1) * DEPTHS, P);
  for (int d = blockIdx.z * DEPTHS; d < last; d++) {
    float total = 0.f, least = 0.f;
    for (int s = 0; d < n && s < count; s++) {
      const float* m = numbers + 13 * s;
      __syncthreads();
      for (int i = id; i < CELLS; i += TILE_X * TILE_Y) {
        const float w = near_[i] + offsets[d], fx = (float)xs[i], fy = (float)ys[i];
        const float z = fmaxf(m[6] * fx + m[7] * fy + m[8] + m[11] * w, 1e-6f);
        const float u = (m[0] * fx + m[1] * fy + m[2] + m[9] * w) / z;
        const float v = (m[3] * fx + m[4] * fy + m[5] + m[10] * w) / z;
        warped[i] = sample(sources + info[3 * s], info[3 * s + 1], info[3 * s + 2], u, v, outside);
      }
      __syncthreads();
      float a = 0.f, b = 0.f, c = 0.f;
      for (int j = 0; j <= 2 * R; j++)
        for (int k = 0; k <= 2 * R; k++) {
          const int i = (threadIdx.y + j) * WIDE + threadIdx.x + k;
          a += warped[i];
          b += warped[i] * warped[i];
          c += warped[i] * shown[i];
        }
      a *= part; b *= part; c *= part;
      float likeness = a < 0.f ? 0.f : (c - a * mine) / (sqrtf(fmaxf(b - a * a, 0.f) + m[12]) * spread);
      likeness = fmaxf(likeness, 0.f);
      total += likeness;
      least = s ? fminf(least, likeness) : likeness;
    }
    // One of the sources may see an object in front.
    if (count == 2) total = total * better + least * (1.f - 2.f * better);
    if (count > 2) total = (total - least) * (1.f / (float)(count - 1));
    const unsigned char cost = d < n ? (unsigned char)(255.f - 255.f * fminf(total, 1.f)) : 255;
    if (inside) out[((long long)y * W + x) * P + d] = cost;
  }
}

// G lanes follow a path, each with LV depths; blockIdx.y is the direction. `total` packs two depths a number.
extern "C" __global__ void scan(const unsigned char* costs, unsigned int* total, const float* grey,
                                int H, int W, int n, int P, int G, int small, int large) {
  const unsigned ALL = 0xffffffffu;
  const int DX[8] = {0, 0, 1, -1, 1, -1, 1, -1}, DY[8] = {1, -1, 0, 0, 1, 1, -1, -1};
  const int way = blockIdx.y, dx = DX[way], dy = DY[way];
  const int lane = threadIdx.x % 32, sub = lane % G, first = sub * LV;
  const int path = (blockIdx.x * blockDim.x + threadIdx.x) / 32 * (32 / G) + lane / G;
  const int paths = way < 2 ? W : way < 4 ? H : H + W - 1;
  // A slanted path that starts at a side has run along that side until there, and adds from there on.
  int x = path, y = dy > 0 ? 0 : H - 1, along = 0;
  if (way >= 2 && way < 4) { x = dx > 0 ? 0 : W - 1; y = path; }
  if (way >= 4 && path >= W) { x = dx > 0 ? 0 : W - 1; along = path - W + 1; }
  bool inside = path < paths;
  float before = 0.f;
  int state[LV];
  for (bool start = true; __any_sync(ALL, inside); start = false) {
    const long long at = inside ? (long long)y * W + x : 0;
    int cost[LV];
    for (int k = 0; k < LV; k += 4) {
      const unsigned int four = first + k < P ? *(const unsigned int*)(costs + at * P + first + k) : 0u;
      for (int j = 0; j < 4; j++) cost[k + j] = first + k + j < n ? (int)(four >> 8 * j & 255u) : INF;
    }
    const float here = grey[at];
    if (start) {
      for (int k = 0; k < LV; k++) state[k] = cost[k];
    } else {
      int low = INF;
      for (int k = 0; k < LV; k++) low = min(low, state[k]);
      for (int o = G / 2; o; o /= 2) low = min(low, __shfl_xor_sync(ALL, low, o, G));
      int left = __shfl_up_sync(ALL, state[LV - 1], 1, G), right = __shfl_down_sync(ALL, state[0], 1, G);
      if (sub == 0) left = INF;
      if (sub == G - 1) right = INF;
      const float price = (float)large / (1.f + fabsf(here - before) / 8.f);
      const int jump = low + (int)fmaxf(price, 1.5f * (float)small);
      for (int k = 0; k < LV; k++) {
        const int now = state[k], after = k + 1 < LV ? state[k + 1] : right;
        const int least = min(min(now, jump), min(left, after) + small);
        state[k] = cost[k] < INF ? least - low + cost[k] : INF;
        left = now;
      }
    }
    if (inside && along <= 0)
      for (int k = 0; k < LV && first + k < n; k += 2) {
        const unsigned int next = first + k + 1 < n ? (unsigned)state[k + 1] << 16 : 0u;
        atomicAdd(total + (at * P + first + k) / 2, (unsigned)state[k] | next);
      }
    x += along > 0 ? 0 : dx;
    y += dy;
    along--;
    before = here;
    inside = inside && x >= 0 && x < W && y >= 0 && y < H;
  }
}

// Each pixel's cheapest depth, refined by a parabola, and its unsmoothed cost.
extern "C" __global__ void cheapest(const unsigned char* costs, const short* total, int pixels, int n, int P,
                                    float* place, float* own) {
  const int at = blockIdx.x * blockDim.x + threadIdx.x;
  if (at >= pixels) return;
  const short* line = total + (long long)at * P;
  int least = 0;
  for (int d = 1; d < n; d++) if (line[d] < line[least]) least = d;
  const int inner = min(max(least, 1), n - 2);
  const float b = line[inner - 1], h = line[inner], a = line[inner + 1];
  const float part = 0.5f * (b - a) / fmaxf(b - 2.f * h + a, 1.f);
  place[at] = (float)inner + fminf(fmaxf(part, -0.5f), 0.5f);
  own[at] = costs[(long long)at * P + least];
}
