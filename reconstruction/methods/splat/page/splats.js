"use strict";
/* Gaussian splats, drawn from back to front as ellipses (Zwicker et al. 2001, Kerbl et al. 2023), for `walk.js`. */
function makePainter({ gl, data, program }) {
  /* Gaussians in a row of a texture, which are drawn at once. */
  const ROW = 1024, NONE = 0xffffffff;
  const SPLAT = `#version 300 es
  precision highp float; precision highp usampler2D;
  uniform usampler2D splats, order; uniform mat4 view; uniform mat3 turn; uniform vec3 eye, low, step; uniform vec2 screen;
  uniform float focal, blur, smallest, ratio;
  out vec2 at; out vec4 colour;
  void main() {
    uint which = texelFetch(order, ivec2(gl_VertexID >> 2, gl_InstanceID), 0).x;
    gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
    if (which == 0xffffffffu) return;
    uvec4 s = texelFetch(splats, ivec2(int(which) & 1023, int(which) >> 10), 0);
    vec3 place = low + step * vec3(s.x & 65535u, s.x >> 16, s.y & 65535u), local = turn * (place - eye);
    vec3 size = smallest * exp(ratio * vec3((s.y >> 16) & 255u, s.y >> 24, s.z & 255u));
    vec3 q = vec3((s.z >> 8) & 255u, (s.z >> 16) & 255u, s.z >> 24) / 127.5 - 1.0;
    vec4 r = vec4(q, sqrt(max(0.0, 1.0 - dot(q, q))));
    if (local.z < 1e-6) return;
    vec2 x = local.xy / local.z;
    float a = blur, b = 0.0, c = blur;
    for (int k = 0; k < 3; k++) {
      vec3 one = vec3(k == 0, k == 1, k == 2);
      vec3 axis = turn * (one + 2.0 * cross(r.xyz, cross(r.xyz, one) + r.w * one)) * size[k];
      vec2 uv = focal * (axis.xy - x * axis.z) / local.z;
      a += uv.x * uv.x; b += uv.x * uv.y; c += uv.y * uv.y;
    }
    /* The ellipse's two radii, in pixels; beside the eye it is none. */
    float middle = 0.5 * (a + c), half_gap = length(vec2(0.5 * (a - c), b));
    float longest = middle + half_gap, shortest = max(middle - half_gap, 0.1);
    if (9.0 * longest > 0.0625 * screen.x * screen.x) return;
    vec2 along = abs(b) > 1e-6 ? normalize(vec2(b, longest - a)) : a >= c ? vec2(1, 0) : vec2(0, 1);
    at = 3.0 * vec2((gl_VertexID & 1) * 2 - 1, (gl_VertexID & 2) - 1);
    vec2 shift = at.x * sqrt(longest) * along + at.y * sqrt(shortest) * vec2(-along.y, along.x);
    vec4 middle_at = view * vec4(place, 1.0);
    gl_Position = vec4(middle_at.xy / middle_at.w + 2.0 * shift * vec2(1, -1) / screen, 0.0, 1.0);
    colour = vec4(s.w & 255u, (s.w >> 8) & 255u, (s.w >> 16) & 255u, s.w >> 24) / 255.0;
  }`;
  const PAINT = `#version 300 es
  precision highp float;
  in vec2 at; in vec4 colour; out vec4 seen;
  void main() {
    float far = dot(at, at), alpha = min(colour.a * exp(-0.5 * far), 0.99);
    if (far > 9.0 || alpha < 1.0 / 255.0) discard;
    seen = vec4(colour.rgb, 1.0) * alpha;
  }`;
  const splat = program(SPLAT, PAINT), places = {};
  gl.useProgram(splat);
  ["splats", "order"].forEach((name, unit) => gl.uniform1i(gl.getUniformLocation(splat, name), unit));
  const corners = new Uint16Array(6 * ROW), quads = gl.createVertexArray();
  for (let i = 0; i < ROW; i++) corners.set([0, 1, 2, 2, 1, 3].map(k => 4 * i + k), 6 * i);
  gl.bindVertexArray(quads);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
  gl.bindVertexArray(null);
  for (const name of ["view", "turn", "eye", "low", "step", "screen", "focal", "blur", "smallest", "ratio"])
    places[name] = gl.getUniformLocation(splat, name);
  const screen = [0, 0];

  async function bytes(text) {
    const packed = await (await fetch(`data:application/octet-stream;base64,${text}`)).arrayBuffer();
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Response(stream).arrayBuffer();
  }
  /* Integers of Gaussians, column by column: each the sum of the differences up to it. */
  async function unpack({ number, splats }) {
    const packed = new Uint8Array(await bytes(splats)), columns = [];
    for (let k = 0, at = 0; k < 12; k++) {
      const column = new Int32Array(number);
      for (let plane = 0; plane < (k < 3 ? 2 : 1); plane++)
        for (let i = 0; i < number; i++) column[i] |= packed[at++] << 8 * plane;
      for (let i = 0, sum = 0; i < number; i++) column[i] = sum += (column[i] >>> 1) ^ -(column[i] & 1);
      columns.push(column);
    }
    return columns;
  }
  const shared = unpack(data.shared), thinner = Math.round(Math.log(data.thin) / data.ratio);
  /* Gaussians as the shader reads them, 4 x 32 bits each. */
  function pack(words, first, [x, y, z, long, wide, i, j, k, green, blue, red, opacity]) {
    const [turns, opacities] = data.levels, [finer, coarser] = data.shifts;
    const byte = (value, levels) => Math.round(255 * value / levels), level = v => Math.min(Math.max(v, 0), 255);
    /* The middle of what was left out. */
    const shade = (value, shift) => (value << shift) + (1 << shift) / 2;
    for (let n = 0; n < x.length; n++) {
      const at = 4 * (first + n), g = shade(green[n], finer);
      words[at] = x[n] | y[n] << 16;
      words[at + 1] = z[n] | (long[n] - thinner) << 16 | (wide[n] - thinner) << 24;
      words[at + 2] = long[n] | byte(i[n], turns) << 8 | byte(j[n], turns) << 16 | byte(k[n], turns) << 24;
      words[at + 3] = level(g + shade(red[n], coarser)) | level(g) << 8 | level(g + shade(blue[n], coarser)) << 16 |
        byte(opacity[n], opacities) << 24;
    }
  }
  async function build(instant) {
    const still = await shared, own = await unpack(instant), number = data.shared.number + instant.number;
    const rows = Math.ceil(number / ROW), words = new Uint32Array(4 * ROW * rows);
    pack(words, 0, still);
    pack(words, data.shared.number, own);
    const made = { number, rows, words, keys: new Uint16Array(number), order: new Uint32Array(ROW * rows) };
    made.order.fill(NONE, number);
    made.textures = [integers(gl.RGBA32UI, rows), integers(gl.R32UI, rows)];
    upload(made.textures[0], gl.RGBA_INTEGER, rows, words);
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

  /* Farthest first: a counting sort of 16 bits of depth, unless the eye looks as before. */
  function sort(made, ahead) {
    if (made.along && made.along.every((x, k) => Math.abs(x - ahead[k]) < 0.002)) return;
    made.along = ahead;
    const { words, keys, order, number } = made, [x, y, z] = ahead.map((a, k) => a * data.step[k]);
    const ends = [0, 0];
    for (const a of [x, y, z]) ends[a < 0 ? 0 : 1] += 65535 * a;
    const scale = 65535 / (ends[1] - ends[0]), counts = new Uint32Array(65537);
    for (let i = 0; i < number; i++) {
      const xy = words[4 * i], depth = x * (xy & 65535) + y * (xy >>> 16) + z * (words[4 * i + 1] & 65535);
      keys[i] = (ends[1] - depth) * scale;
      counts[1 + keys[i]]++;
    }
    for (let k = 1; k < counts.length; k++) counts[k] += counts[k - 1];
    for (let i = 0; i < number; i++) order[counts[keys[i]]++] = i;
    upload(made.textures[1], gl.RED_INTEGER, made.rows, order);
  }
  function draw(made, camera, painted) {
    sort(made, camera.ahead);
    gl.bindFramebuffer(gl.FRAMEBUFFER, painted);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(splat);
    gl.uniformMatrix4fv(places.view, false, camera.matrix);
    const { right, down, ahead } = camera;
    gl.uniformMatrix3fv(places.turn, false, [0, 1, 2].flatMap(k => [right[k], down[k], ahead[k]]));
    for (const [name, value] of [["eye", camera.from], ["low", data.low], ["step", data.step]])
      gl.uniform3fv(places[name], value);
    gl.uniform2fv(places.screen, screen);
    const focal = camera.focal;
    gl.uniform1f(places.focal, focal);
    /* A larger picture than those of the cameras has larger Gaussians, not gaps. */
    gl.uniform1f(places.blur, data.blur * Math.max(1, focal / data.focal) ** 2);
    gl.uniform1f(places.smallest, data.smallest * Math.exp(data.ratio * thinner));
    gl.uniform1f(places.ratio, data.ratio);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, made.textures[1]);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, made.textures[0]);
    gl.bindVertexArray(quads);
    gl.drawElementsInstanced(gl.TRIANGLES, corners.length, gl.UNSIGNED_SHORT, 0, made.rows);
    gl.disable(gl.BLEND);
  }
  return { resize: (width, height) => { screen[0] = width; screen[1] = height; }, build, free, draw };
}
