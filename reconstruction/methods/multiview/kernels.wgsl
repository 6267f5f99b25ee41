// GPU kernels of the sweep: matching costs, their semi-global scan, and the cheapest depths.
// Volumes are bands of rows: costs are rows x width x words, four depths a word, totals the same with two words for
// four depths; a dispatch sees one band. `gpu.py` puts constants before this text: R, half a window; LANES, the words of
// a path, rounded up to a power of two; OUTSIDE, BETTER, JUMP_GREY and MIN_JUMP as in Python.

struct Task {
  top: i32, rows: i32, odd: i32, way: i32, height: i32, width: i32, depths: i32, words: i32, sources: i32, small: i32,
  large: i32,
};
@group(0) @binding(0) var<storage, read> task: Task;
// The reference's grey levels, the mean and the deviation of each pixel's window, its surface; then the sources' grey.
@group(0) @binding(1) var<storage, read> pictures: array<f32>;
// The bits of the offsets; then of each source its first pixel, width and height, and the bits of its 13 numbers.
@group(0) @binding(2) var<storage, read> table: array<i32>;
@group(0) @binding(3) var<storage, read_write> costs: array<u32>;
@group(0) @binding(4) var<storage, read_write> total: array<atomic<u32>>;
// The paths' costs at the last row of the band before.
@group(0) @binding(5) var<storage, read_write> carried: array<vec4<i32>>;
@group(0) @binding(6) var<storage, read_write> found: array<f32>;

const TILE_X = 16;
const TILE_Y = 8;
const WIDE = TILE_X + 2 * R;
const CELLS = WIDE * (TILE_Y + 2 * R);
const FAR = 1 << 20;
var<workgroup> warped: array<f32, CELLS>;
var<workgroup> shown: array<f32, CELLS>;
var<workgroup> surface: array<f32, CELLS>;

fn mirrored(at: i32, size: i32) -> i32 {
  let inside = abs(at);
  return select(inside, max(2 * size - 2 - inside, 0), inside >= size);
}

fn number(at: i32) -> f32 { return bitcast<f32>(table[at]); }

fn pixel(source: i32, x: i32, y: i32) -> f32 {
  if (x < 0 || y < 0 || x >= table[source + 1] || y >= table[source + 2]) { return OUTSIDE; }
  return pictures[table[source] + y * table[source + 1] + x];
}

fn sample(source: i32, u: f32, v: f32) -> f32 {
  if (!(u > -1.0 && v > -1.0 && u < f32(table[source + 1]) && v < f32(table[source + 2]))) { return OUTSIDE; }
  let left = floor(u);
  let top = floor(v);
  let x = i32(left);
  let y = i32(top);
  let tl = pixel(source, x, y);
  let bl = pixel(source, x, y + 1);
  let above = tl + (pixel(source, x + 1, y) - tl) * (u - left);
  let below = bl + (pixel(source, x + 1, y + 1) - bl) * (u - left);
  return above + (below - above) * (v - top);
}

// Costs of a tile of the reference at four depths.
@compute @workgroup_size(TILE_X, TILE_Y, 1)
fn match_windows(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>,
                 @builtin(local_invocation_index) index: u32) {
  let x0 = i32(group.x) * TILE_X;
  let y0 = task.top + i32(group.y) * TILE_Y;
  let x = x0 + i32(local.x);
  let y = y0 + i32(local.y);
  let pixels = task.height * task.width;
  for (var i = i32(index); i < CELLS; i += TILE_X * TILE_Y) {
    let at = mirrored(y0 + i / WIDE - R, task.height) * task.width + mirrored(x0 + i % WIDE - R, task.width);
    shown[i] = pictures[at];
    surface[i] = pictures[3 * pixels + at];
  }
  let inside = x < task.width && y < task.top + task.rows;
  let own = select(0, y * task.width + x, inside);
  let mean = pictures[pixels + own];
  let deviation = pictures[2 * pixels + own];
  let part = 1.0 / f32((2 * R + 1) * (2 * R + 1));
  var four = 0u;
  for (var k = 0; k < 4; k++) {
    let depth = 4 * i32(group.z) + k;
    var sum = 0.0;
    var least = 2.0;
    for (var s = 0; depth < task.depths && s < task.sources; s++) {
      let source = task.depths + 16 * s;
      let m = source + 3;
      workgroupBarrier();
      for (var i = i32(index); i < CELLS; i += TILE_X * TILE_Y) {
        let fx = f32(mirrored(x0 + i % WIDE - R, task.width));
        let fy = f32(mirrored(y0 + i / WIDE - R, task.height));
        let w = surface[i] + number(depth);
        let z = max(number(m + 6) * fx + number(m + 7) * fy + number(m + 8) + number(m + 11) * w, 1e-6);
        let u = (number(m) * fx + number(m + 1) * fy + number(m + 2) + number(m + 9) * w) / z;
        let v = (number(m + 3) * fx + number(m + 4) * fy + number(m + 5) + number(m + 10) * w) / z;
        warped[i] = sample(source, u, v);
      }
      workgroupBarrier();
      var a = 0.0;
      var b = 0.0;
      var c = 0.0;
      for (var j = 0; j <= 2 * R; j++) {
        for (var q = 0; q <= 2 * R; q++) {
          let i = (i32(local.y) + j) * WIDE + i32(local.x) + q;
          a += warped[i];
          b += warped[i] * warped[i];
          c += warped[i] * shown[i];
        }
      }
      a *= part;
      b *= part;
      c *= part;
      // A mean below zero: the window touches what the source does not show.
      var likeness = 0.0;
      if (a >= 0.0) {
        likeness = max((c - a * mean) / (sqrt(max(b - a * a, 0.0) + number(m + 12)) * deviation), 0.0);
      }
      sum += likeness;
      least = min(least, likeness);
    }
    // One of the sources may see an object in front.
    if (task.sources == 2) { sum = sum * BETTER + least * (1.0 - 2.0 * BETTER); }
    if (task.sources > 2) { sum = (sum - least) / f32(task.sources - 1); }
    four |= select(255u, u32(255.0 - 255.0 * min(sum, 1.0)), depth < task.depths) << u32(8 * k);
  }
  if (inside) { costs[((y - task.top) * task.width + x) * task.words + i32(group.z)] = four; }
}

const THREADS = 128;
const PATHS = THREADS / LANES;
const DX = array<i32, 8>(0, 1, -1, 1, -1, 0, 1, -1);
const DY = array<i32, 8>(1, 1, 1, 0, 0, -1, -1, -1);
// What lanes of a path publish after each pixel, in turn: their first and last depth's cost, and the path's least.
var<workgroup> first: array<i32, 2 * THREADS>;
var<workgroup> last: array<i32, 2 * THREADS>;
var<workgroup> low: array<atomic<i32>, 3 * PATHS>;

fn publish(turn: i32, lane: i32, slot: i32, state: vec4<i32>) {
  first[(turn & 1) * THREADS + lane] = state.x;
  last[(turn & 1) * THREADS + lane] = state.w;
  atomicMin(&low[turn % 3 * PATHS + slot], min(min(state.x, state.y), min(state.z, state.w)));
}

// One direction's paths through a band, adding their costs to the totals; a lane has four depths of a path. A slanted
// path that starts at a side runs along that side until its row, and adds from there on.
@compute @workgroup_size(THREADS, 1, 1)
fn scan(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) index: u32) {
  let lane = i32(index);
  let word = lane % LANES;
  let slot = lane / LANES;
  let path = i32(group.x) * PATHS + slot;
  let way = task.way + i32(group.y);
  let width = task.width;
  var dxs = DX;
  var dys = DY;
  let dx = dxs[way];
  let dy = dys[way];
  let across = dy == 0;
  let side = select(width - 1, 0, dx > 0);
  let starts = select(width + select(task.rows - 1, 0, dx == 0), task.rows, across);
  let real = path < starts && word < task.words;
  var x = select(path, side, across || path >= width);
  var y = select(select(task.rows - 1, 0, dy > 0), path, across);
  var wait = select(max(path - width + 1, 0), 0, across);
  let beyond = task.top + y - dy;
  var started = !across && beyond >= 0 && beyond < task.height;
  var state = vec4<i32>(FAR);
  var before = 0.0;
  if (real && started) {
    let from_x = clamp(x - dx, 0, width - 1);
    state = carried[(((1 - task.odd) * 8 + way) * width + from_x) * task.words + word];
    before = pictures[beyond * width + from_x];
  }
  if (word == 0) { for (var i = 0; i < 3; i++) { atomicStore(&low[i * PATHS + slot], FAR); } }
  workgroupBarrier();
  publish(0, lane, slot, state);
  workgroupBarrier();
  let steps = select(task.rows, width, across);
  for (var turn = 0; turn < steps; turn++) {
    if (real && x >= 0 && x < width) {
      let at = y * width + x;
      let here = pictures[task.top * width + at];
      let four = vec4<i32>((vec4<u32>(costs[at * task.words + word]) >> vec4<u32>(0, 8, 16, 24)) & vec4<u32>(255));
      var now = four;
      if (started) {
        let read = (turn & 1) * THREADS + lane;
        var left = FAR;
        var right = FAR;
        if (word > 0) { left = last[read - 1]; }
        if (word < LANES - 1) { right = first[read + 1]; }
        let least = atomicLoad(&low[turn % 3 * PATHS + slot]);
        let price = f32(task.large) / (1.0 + abs(here - before) / JUMP_GREY);
        let jump = least + i32(max(price, MIN_JUMP * f32(task.small)));
        let beside = min(vec4<i32>(left, state.xyz), vec4<i32>(state.yzw, right)) + task.small;
        now = min(min(state, vec4<i32>(jump)), beside) - least + four;
      }
      let depth = vec4<i32>(4 * word) + vec4<i32>(0, 1, 2, 3);
      state = select(now, vec4<i32>(FAR), depth >= vec4<i32>(task.depths));
      if (wait <= 0) {
        let pairs = 2 * (at * task.words + word);
        let sums = vec4<u32>(state) & vec4<u32>(0xffff);
        atomicAdd(&total[pairs], sums.x | (sums.y << 16));
        atomicAdd(&total[pairs + 1], sums.z | (sums.w << 16));
        if (turn == steps - 1) { carried[((task.odd * 8 + way) * width + x) * task.words + word] = state; }
        x += dx;
      }
      started = true;
      before = here;
    }
    y += dy;
    wait--;
    if (word == 0) { atomicStore(&low[(turn + 2) % 3 * PATHS + slot], FAR); }
    publish(turn + 1, lane, slot, state);
    workgroupBarrier();
  }
}

fn sum_of(pixel: i32, depth: i32) -> i32 {
  return i32((atomicLoad(&total[2 * pixel * task.words + depth / 2]) >> u32(16 * (depth & 1))) & 0xffffu);
}

// Each pixel's cheapest depth, refined by a parabola, and its unsmoothed cost.
@compute @workgroup_size(64, 1, 1)
fn choose(@builtin(global_invocation_id) at: vec3<u32>) {
  let x = i32(at.x);
  if (x >= task.width || i32(at.y) >= task.rows) { return; }
  let pixel = i32(at.y) * task.width + x;
  var cheapest = 0;
  var least = sum_of(pixel, 0);
  for (var d = 1; d < task.depths; d++) {
    let sum = sum_of(pixel, d);
    if (sum < least) { least = sum; cheapest = d; }
  }
  let inner = min(max(cheapest, 1), task.depths - 2);
  let b = f32(sum_of(pixel, inner - 1));
  let a = f32(sum_of(pixel, inner + 1));
  let part = 0.5 * (b - a) / max(b - 2.0 * f32(sum_of(pixel, inner)) + a, 1.0);
  let place = task.top * task.width + pixel;
  found[place] = f32(inner) + clamp(part, -0.5, 0.5);
  let four = costs[pixel * task.words + cheapest / 4];
  found[task.height * task.width + place] = f32((four >> u32(8 * (cheapest & 3))) & 255u);
}
