"use strict";
/* People as bones and joints, each joint within a ball of its error, for `walk.js`; gaps are not drawn. An unsure joint,
   whose error is a large part of the person, is a ring without a ball, which would cover the others. */
function makePainter({ gl, data, program }) {
  const FLAT = `#version 300 es
  layout(location = 0) in vec2 at; layout(location = 1) in vec4 paint;
  out vec4 colour;
  void main() { gl_Position = vec4(at, 0.0, 1.0); colour = paint; }`;
  const PAINT = `#version 300 es
  precision highp float;
  in vec4 colour; out vec4 seen;
  void main() { seen = vec4(colour.rgb * colour.a, colour.a); }`;
  const flat = program(FLAT, PAINT), array = gl.createVertexArray(), buffer = gl.createBuffer();
  gl.bindVertexArray(array);
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.enableVertexAttribArray(0);
  gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 24, 0);
  gl.enableVertexAttribArray(1);
  gl.vertexAttribPointer(1, 4, gl.FLOAT, false, 24, 8);
  gl.bindVertexArray(null);
  const COLOURS = [[.15, .71, .67], [.98, .51, .16], [.83, .34, .86], [.91, .71, .34], [.31, .78, .47], [.94, .31, .31]];
  const GREY = [.42, .46, .52], ROUND = 20, UNSURE = .15;
  const screen = { width: 2, height: 2 };
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

  /* The floor: a grid around the people of some instants, as low as their lowest joint usually is. */
  let lines = [];
  function layFloor(instants) {
    const { right, down, ahead } = data.path, joints = instants.map(({ people }) => people.flat().filter(Boolean));
    const lowest = joints.filter(each => each.length).map(each => Math.max(...each.map(at => dot(at, down))));
    if (!lowest.length) return;
    const floor = lowest.sort((a, b) => a - b)[lowest.length >> 1];
    const ends = [right, ahead].map(axis => joints.flat().reduce(([low, high], at) =>
      [Math.min(low, dot(at, axis)), Math.max(high, dot(at, axis))], [Infinity, -Infinity]));
    const wide = Math.max(...ends.map(([low, high]) => high - low), 1e-6), step = 10 ** Math.round(Math.log10(wide / 3));
    const ranges = ends.map(([low, high]) => [Math.floor(low / step) - 1, Math.ceil(high / step) + 1]);
    const place = (a, b) => right.map((x, k) => a * step * x + b * step * ahead[k] + floor * down[k]);
    const steps = ([low, high]) => Array.from({ length: Math.min(high - low, 60) + 1 }, (_, k) => low + k);
    lines = [
      ...steps(ranges[0]).map(a => [place(a, ranges[1][0]), place(a, ranges[1][1])]),
      ...steps(ranges[1]).map(b => [place(ranges[0][0], b), place(ranges[0][1], b)]),
    ];
  }
  layFloor(data.instants);

  function draw({ people }, { from, right, down, ahead, focal, cx, cy }, { painted }) {
    const { width, height } = screen, shapes = [], near = data.path.near;
    const local = p => { const d = from.map((x, k) => p[k] - x); return [dot(d, right), dot(d, down), dot(d, ahead)]; };
    const pixel = ([x, y, z]) => [cx + focal * x / z, cy + focal * y / z];
    const ndc = ([x, y]) => [2 * x / width - 1, 1 - 2 * y / height];
    function line(p, q, thick, colour, alpha, behind = 0) {
      let a = local(p), b = local(q);
      if (a[2] < near && b[2] < near) return;
      const cut = (u, v) => u[2] < near ? u.map((x, k) => x + (v[k] - x) * (near - u[2]) / (v[2] - u[2])) : u;
      [a, b] = [cut(a, b), cut(b, a)];
      const [s, t] = [pixel(a), pixel(b)], long = Math.hypot(t[0] - s[0], t[1] - s[1]) || 1;
      const aside = [-(t[1] - s[1]) / long * thick / 2, (t[0] - s[0]) / long * thick / 2];
      const corners = [[s, 1], [s, -1], [t, 1], [t, -1]].map(([e, f]) => ndc([e[0] + f * aside[0], e[1] + f * aside[1]]));
      shapes.push([(a[2] + b[2]) / 2 + behind, [0, 1, 2, 1, 3, 2].map(k => corners[k]), colour, alpha]);
    }
    function ball(p, radius, least, colour, alpha, behind, hollow = 0) {
      const c = local(p);
      if (c[2] < near) return;
      const [x, y] = pixel(c), r = Math.max(least, focal * radius / c[2]);
      const rim = (k, part = 1) =>
        ndc([x + part * r * Math.cos(2 * Math.PI * k / ROUND), y + part * r * Math.sin(2 * Math.PI * k / ROUND)]);
      const corners = Array.from({ length: ROUND }, (_, k) =>
        [rim(k, hollow), rim(k), rim(k + 1), rim(k, hollow), rim(k + 1), rim(k + 1, hollow)]).flat();
      shapes.push([c[2] + behind, corners, colour, alpha]);
    }
    const thin = Math.max(1, height / 700);
    for (const [p, q] of lines) line(p, q, thin, GREY, .35, 1e9);
    people.forEach((joints, number) => {
      const colour = COLOURS[number % COLOURS.length], pale = colour.map(x => .55 + .45 * x);
      const known = joints.filter(Boolean), extent = axis => Math.max(...known.map(at => at[axis])) - Math.min(...known.map(at => at[axis]));
      const size = Math.hypot(...[0, 1, 2].map(extent)), isUnsure = joint => joint[3] > UNSURE * size;
      for (const [a, b] of data.bones) if (joints[a] && joints[b]) {
        const unsure = isUnsure(joints[a]) || isUnsure(joints[b]);
        line(joints[a], joints[b], (unsure ? 2 : 5) * thin, colour, unsure ? .5 : 1);
      }
      for (const joint of known) {
        if (isUnsure(joint)) ball(joint, 0, 4.5 * thin, pale, 1, -1e-3, .6);
        else {
          ball(joint, joint[3], 0, colour, .18, 1e-3);
          ball(joint, 0, 3.2 * thin, pale, 1, -1e-3);
        }
      }
    });
    shapes.sort((a, b) => b[0] - a[0]);
    const values = shapes.flatMap(([, corners, colour, alpha]) => corners.flatMap(at => [...at, ...colour, alpha]));
    gl.bindFramebuffer(gl.FRAMEBUFFER, painted);
    gl.clearColor(.07, .08, .1, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(flat);
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.DYNAMIC_DRAW);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.drawArrays(gl.TRIANGLES, 0, values.length / 6);
    gl.disable(gl.BLEND);
    gl.bindVertexArray(null);
  }
  const resize = (width, height) => Object.assign(screen, { width, height });
  return { resize, layFloor, build: async instant => instant, free: () => {}, draw };
}
