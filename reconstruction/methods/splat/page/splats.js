"use strict";
/* Gaussian splats, drawn as ellipses (Zwicker et al. 2001, Kerbl et al. 2023), for `walk.js`: by a GPU from back to front,
 * without one by this script from front to back. */
function makePainter({ gl, data, program, empty }) {
  const ROW = 1024, largest = gl.getParameter(gl.ALIASED_POINT_SIZE_RANGE)[1];
  const SPLAT = `#version 300 es
  precision highp float; precision highp usampler2D;
  uniform usampler2D splats, order; uniform mat4 view; uniform mat3 turn; uniform vec3 eye, low, step;
  uniform float focal, blur, smallest, ratio, widest;
  out vec4 colour; out vec3 bend; out float side;
  void main() {
    int which = int(texelFetch(order, ivec2(gl_VertexID & 1023, gl_VertexID >> 10), 0).x);
    uvec4 s = texelFetch(splats, ivec2(which & 1023, which >> 10), 0);
    vec3 place = low + step * vec3(s.x & 65535u, s.x >> 16, s.y & 65535u), local = turn * (place - eye);
    gl_Position = view * vec4(place, 1.0);
    vec3 size = smallest * exp(ratio * vec3((s.y >> 16) & 255u, s.y >> 24, s.z & 255u));
    vec3 q = vec3((s.z >> 8) & 255u, (s.z >> 16) & 255u, s.z >> 24) / 127.5 - 1.0;
    vec4 r = vec4(q, sqrt(max(0.0, 1.0 - dot(q, q))));
    vec2 x = local.xy / local.z;
    float a = blur, b = 0.0, c = blur;
    for (int k = 0; k < 3; k++) {
      vec3 one = vec3(k == 0, k == 1, k == 2);
      vec3 axis = turn * (one + 2.0 * cross(r.xyz, cross(r.xyz, one) + r.w * one)) * size[k];
      vec2 uv = focal * (axis.xy - x * axis.z) / local.z;
      a += uv.x * uv.x; b += uv.x * uv.y; c += uv.y * uv.y;
    }
    colour = vec4(s.w & 255u, (s.w >> 8) & 255u, (s.w >> 16) & 255u, s.w >> 24) / 255.0;
    bend = vec3(c, -b, a) / (a * c - b * b);
    /* As far as it is seen; beside the eye it is none. */
    side = 2.0 * sqrt(max(a, c) * clamp(2.0 * log(255.0 * colour.a), 0.0, 9.0));
    if (local.z < 1e-6 || side > widest) gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
    gl_PointSize = side = clamp(side, 1.0, ${largest.toFixed(1)});
  }`;
  const PAINT = `#version 300 es
  precision highp float;
  in vec4 colour; in vec3 bend; in float side; out vec4 seen;
  void main() {
    vec2 at = side * (gl_PointCoord - 0.5);
    float alpha = min(colour.a * exp(-0.5 * dot(bend, vec3(at.x * at.x, 2.0 * at.x * at.y, at.y * at.y))), 0.99);
    if (alpha < 1.0 / 255.0) discard;
    seen = vec4(colour.rgb, 1.0) * alpha;
  }`;
  const splat = program(SPLAT, PAINT), places = {};
  gl.useProgram(splat);
  ["splats", "order"].forEach((name, unit) => gl.uniform1i(gl.getUniformLocation(splat, name), unit));
  for (const name of ["view", "turn", "eye", "low", "step", "focal", "blur", "smallest", "ratio", "widest"])
    places[name] = gl.getUniformLocation(splat, name);
  const screen = {};

  /* The emulation of a GPU takes several times as long as `paint`. */
  const emulated = /swiftshader|llvmpipe|software|basic render/i.test(
    gl.getParameter(gl.getExtension("WEBGL_debug_renderer_info")?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER));

  async function bytes(text) {
    const packed = await (await fetch(`data:application/octet-stream;base64,${text}`)).arrayBuffer();
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }
  /* Integers of Gaussians, column by column: each the sum of the differences up to it. */
  async function unpack({ number, splats }) {
    const packed = await bytes(splats), columns = [];
    for (let k = 0, at = 0; k < 12; k++) {
      const column = new Int32Array(number);
      for (let plane = 0; plane < (k < 3 ? 2 : 1); plane++)
        for (let i = 0; i < number; i++) column[i] |= packed[at++] << 8 * plane;
      for (let i = 0, sum = 0; i < number; i++) column[i] = sum += (column[i] >>> 1) ^ -(column[i] & 1);
      columns.push(column);
    }
    return columns;
  }
  const thinner = Math.round(Math.log(data.thin) / data.ratio);
  const smallest = data.smallest * Math.exp(data.ratio * thinner);
  /* Gaussians as the shader reads them, 4 x 32 bits each. */
  function pack([x, y, z, long, wide, i, j, k, green, blue, red, opacity]) {
    const words = new Uint32Array(4 * x.length);
    const [turns, opacities] = data.levels, [finer, coarser] = data.shifts;
    const byte = (value, levels) => Math.round(255 * value / levels), level = v => Math.min(Math.max(v, 0), 255);
    /* The middle of what was left out. */
    const shade = (value, shift) => (value << shift) + (1 << shift) / 2;
    for (let n = 0; n < x.length; n++) {
      const at = 4 * n, g = shade(green[n], finer);
      words[at] = x[n] | y[n] << 16;
      words[at + 1] = z[n] | (long[n] - thinner) << 16 | (wide[n] - thinner) << 24;
      words[at + 2] = long[n] | byte(i[n], turns) << 8 | byte(j[n], turns) << 16 | byte(k[n], turns) << 24;
      words[at + 3] = level(g + shade(red[n], coarser)) | level(g) << 8 | level(g + shade(blue[n], coarser)) << 16 |
        byte(opacity[n], opacities) << 24;
    }
    return words;
  }
  /* The words of an instant: those that stay of the instant before, and its own. */
  const own = new Map();
  let last = { at: -1, words: new Uint32Array(0) };
  async function wordsOf(at) {
    let { at: known, words } = last.at <= at ? last : { at: -1, words: new Uint32Array(0) };
    while (known++ < at) {
      const instant = data.instants[known];
      if (!own.has(known)) own.set(known, Promise.all([bytes(instant.stay), unpack(instant).then(pack)]));
      const [stay, others] = await own.get(known), before = words;
      let number = 0;
      words = new Uint32Array(before.length + others.length);
      for (let i = 0; i < before.length / 4; i++)
        if (stay[i >> 3] << (i & 7) & 128) for (let k = 0; k < 4; k++) words[number++] = before[4 * i + k];
      words.set(others, number);
      words = words.subarray(0, number + others.length);
    }
    last = { at, words };
    return words;
  }
  async function build(instant) {
    const found = await wordsOf(data.instants.indexOf(instant)), number = found.length / 4;
    const rows = Math.ceil(number / ROW), words = new Uint32Array(4 * ROW * rows);
    words.set(found);
    const solids = emulated ? solid(found) : null;
    const made = { number, rows, words, solids, keys: new Uint16Array(number), order: new Uint32Array(ROW * rows) };
    made.textures = emulated ? [] : [integers(gl.RGBA32UI, rows), integers(gl.R32UI, rows)];
    if (!emulated) upload(made.textures[0], gl.RGBA_INTEGER, rows, words);
    return made;
  }
  function integers(format, rows) {
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, ROW, rows);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
      gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    return texture;
  }
  function upload(texture, format, rows, values) {
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, ROW, rows, format, gl.UNSIGNED_INT, values);
  }
  const free = made => made.textures.forEach(texture => gl.deleteTexture(texture));

  /* Farthest first: a counting sort of 16 bits of depth, of a `share` of all, unless the eye looks as before. */
  function sort(made, ahead, share) {
    const same = made.share === share && made.along.every((x, k) => Math.abs(x - ahead[k]) < (share < 1 ? 0.02 : 0.002));
    if (same) return false;
    Object.assign(made, { along: ahead, share });
    const { words, keys, order, number } = made, [x, y, z] = ahead.map((a, k) => a * data.step[k]);
    const ends = [0, 0], counts = new Uint32Array(65537), taken = Math.round(65536 * share);
    for (const a of [x, y, z]) ends[a < 0 ? 0 : 1] += 65535 * a;
    const scale = 65535 / (ends[1] - ends[0]), left = i => (i * 40503 & 65535) < taken;
    for (let i = 0; i < number; i++) {
      if (!left(i)) continue;
      const xy = words[4 * i], depth = x * (xy & 65535) + y * (xy >>> 16) + z * (words[4 * i + 1] & 65535);
      keys[i] = (ends[1] - depth) * scale;
      counts[1 + keys[i]]++;
    }
    for (let k = 1; k < counts.length; k++) counts[k] += counts[k - 1];
    made.sorted = counts[65536];
    for (let i = 0; i < number; i++) if (left(i)) order[counts[keys[i]]++] = i;
    return true;
  }
  const bell = Float32Array.from({ length: 1152 }, (_, k) => Math.exp(-(k + 0.5) / 256));
  const reaches = Float32Array.from({ length: 256 }, (_, alpha) => Math.min(4.5, Math.log(Math.max(1, alpha))));
  /* Places (3) and covariances (6) of Gaussians. */
  function solid(words) {
    const solids = new Float32Array(9 * words.length / 4), [lx, ly, lz] = data.low, [sx, sy, sz] = data.step;
    const variance = Float64Array.from({ length: 256 }, (_, k) => (smallest * Math.exp(data.ratio * k)) ** 2);
    for (let from = 0, to = 0; from < words.length; from += 4, to += 9) {
      const xy = words[from], zs = words[from + 1], turn = words[from + 2];
      const i = (turn >>> 8 & 255) / 127.5 - 1, j = (turn >>> 16 & 255) / 127.5 - 1, k = (turn >>> 24) / 127.5 - 1;
      const w = Math.sqrt(Math.max(0, 1 - i * i - j * j - k * k)), third = variance[turn & 255];
      solids[to] = lx + sx * (xy & 65535);
      solids[to + 1] = ly + sy * (xy >>> 16);
      solids[to + 2] = lz + sz * (zs & 65535);
      /* Of the two axes along the surface, whose variances differ from that across it. */
      const p = variance[zs >>> 16 & 255] - third, q = variance[zs >>> 24] - third;
      const ax = 1 - 2 * (j * j + k * k), ay = 2 * (i * j + k * w), az = 2 * (i * k - j * w);
      const bx = 2 * (i * j - k * w), by = 1 - 2 * (i * i + k * k), bz = 2 * (j * k + i * w);
      solids[to + 3] = third + p * ax * ax + q * bx * bx;
      solids[to + 4] = p * ax * ay + q * bx * by;
      solids[to + 5] = p * ax * az + q * bx * bz;
      solids[to + 6] = third + p * ay * ay + q * by * by;
      solids[to + 7] = p * ay * az + q * by * bz;
      solids[to + 8] = third + p * az * az + q * bz * bz;
    }
    return solids;
  }
  /* Nearest first: what is behind enough light-tight ones costs nothing. */
  function paint(made, { from, right, down, ahead, focal, cx, cy }, blur) {
    const { words, order, sorted, solids: s, share } = made, { width, height, sums, passes, bytes } = screen;
    const [ex, ey, ez] = from, [rx, ry, rz] = right, [dx, dy, dz] = down, [ax, ay, az] = ahead;
    sums.fill(0);
    passes.fill(1);
    for (let k = sorted - 1; k >= 0; k--) {
      const i = order[k], n = 9 * i, x = s[n] - ex, y = s[n + 1] - ey, z = s[n + 2] - ez;
      const depth = ax * x + ay * y + az * z;
      if (depth < 1e-6) continue;
      const across = (rx * x + ry * y + rz * z) / depth, along = (dx * x + dy * y + dz * z) / depth, f = focal / depth / Math.sqrt(share);
      const px = focal * across + cx - 0.5, py = focal * along + cy - 0.5;
      if (px < -99 || py < -99 || px > width + 99 || py > height + 99) continue;
      const ux = f * (rx - across * ax), uy = f * (ry - across * ay), uz = f * (rz - across * az);
      const vx = f * (dx - along * ax), vy = f * (dy - along * ay), vz = f * (dz - along * az);
      const xx = s[n + 3], xy = s[n + 4], xz = s[n + 5], yy = s[n + 6], yz = s[n + 7], zz = s[n + 8];
      const wx = xx * ux + xy * uy + xz * uz, wy = xy * ux + yy * uy + yz * uz, wz = xz * ux + yz * uy + zz * uz;
      const a = blur + wx * ux + wy * uy + wz * uz, b = wx * vx + wy * vy + wz * vz;
      const c = blur + vx * (xx * vx + 2 * (xy * vy + xz * vz)) + vy * (yy * vy + 2 * yz * vz) + zz * vz * vz;
      const colour = words[4 * i + 3], alpha = colour >>> 24, reach = reaches[alpha];
      const wide = Math.sqrt(2 * reach * a), high = Math.sqrt(2 * reach * c);
      if (wide > 0.125 * width || high > 0.125 * width) continue;
      const left = Math.max(0, Math.ceil(px - wide)), end = Math.min(width - 1, px + wide);
      const last = Math.min(height - 1, py + high), scale = 128 / (a * c - b * b), limit = 256 * reach;
      const red = colour & 255, green = colour >>> 8 & 255, blue = colour >>> 16 & 255;
      for (let row = Math.max(0, Math.ceil(py - high)); row <= last; row++) {
        const q = row - py, qq = scale * a * q * q, pq = -2 * scale * b * q;
        for (let column = left, to = width * (height - 1 - row) + left; column <= end; column++, to++) {
          const light = passes[to];
          if (light < 1 / 255) continue;
          const p = column - px, far = qq + p * (pq + scale * c * p);
          if (far >= limit) continue;
          const weight = light * Math.min(alpha / 255 * bell[far | 0], 0.99);
          passes[to] = light - weight;
          sums[3 * to] += weight * red;
          sums[3 * to + 1] += weight * green;
          sums[3 * to + 2] += weight * blue;
        }
      }
    }
    for (let k = 0, n = 0; k < passes.length; k++) {
      bytes[4 * k] = sums[n++]; bytes[4 * k + 1] = sums[n++]; bytes[4 * k + 2] = sums[n++]; bytes[4 * k + 3] = 255.5 - 255 * passes[k];
    }
  }
  function draw(made, camera, { painted, means }, share = 1) {
    const focal = camera.focal;
    /* A larger picture than those of the cameras has larger Gaussians, not gaps. */
    const blur = data.blur * Math.max(1, focal / data.focal) ** 2;
    if (emulated) {
      sort(made, camera.ahead, share);
      paint(made, camera, blur);
      gl.bindTexture(gl.TEXTURE_2D, means);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, screen.width, screen.height, gl.RGBA, gl.UNSIGNED_BYTE, screen.bytes);
      return;
    }
    if (sort(made, camera.ahead, share)) upload(made.textures[1], gl.RED_INTEGER, made.rows, made.order);
    gl.bindFramebuffer(gl.FRAMEBUFFER, painted);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(splat);
    gl.uniformMatrix4fv(places.view, false, camera.matrix);
    const { right, down, ahead } = camera;
    gl.uniformMatrix3fv(places.turn, false, [0, 1, 2].flatMap(k => [right[k], down[k], ahead[k]]));
    for (const [name, value] of [["eye", camera.from], ["low", data.low], ["step", data.step]])
      gl.uniform3fv(places[name], value);
    for (const [name, value] of Object.entries({
      focal, blur, smallest: smallest / Math.sqrt(share), ratio: data.ratio, widest: 0.25 * screen.width }))
      gl.uniform1f(places[name], value);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, made.textures[1]);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, made.textures[0]);
    gl.bindVertexArray(empty);
    gl.drawArrays(gl.POINTS, 0, made.sorted);
    gl.disable(gl.BLEND);
  }
  function resize(width, height) {
    const pixels = emulated ? width * height : 0;
    Object.assign(screen, { width, height, sums: new Float32Array(3 * pixels), passes: new Float32Array(pixels) });
    screen.bytes = new Uint8Array(4 * pixels);
  }
  return { resize, build, free, draw };
}
