"use strict";
/* A page to walk round in: the place of the eye, time, and what no camera saw. `makePainter` draws the moment.
 * Rig coordinates: x right, y down. */
(() => {
  const data = JSON.parse(document.getElementById("moments").textContent);
  const stage = document.getElementById("stage"), canvas = document.getElementById("canvas");
  const hint = document.getElementById("hint");
  const gl = canvas.getContext("webgl2", { antialias: false, alpha: false });
  if (!gl) {
    hint.textContent = "This browser shows no 3D (WebGL 2), so here is the view from the middle of the rig.";
    return;
  }

  const FLAT = `#version 300 es
  void main() { gl_Position = vec4(vec2((gl_VertexID << 1) & 2, gl_VertexID & 2) * 2.0 - 1.0, 0, 1); }`;
  /* Where no camera saw anything, means of ever larger neighbourhoods. */
  const SHOW = `#version 300 es
  precision highp float;
  uniform sampler2D means; uniform vec2 size; out vec4 colour;
  void main() {
    vec4 seen = vec4(0.0);
    for (float level = 0.0; level < 9.0 && seen.a < 0.99; level++) {
      vec4 here = textureLod(means, gl_FragCoord.xy / size, level);
      float more = level == 0.0 ? here.a : min(1.0, 3.0 * here.a);
      seen += (1.0 - seen.a) * more * vec4(here.rgb / max(here.a, 1e-3), 1.0);
    }
    colour = vec4(seen.rgb / max(seen.a, 1e-3), 1.0);
  }`;

  function program(vertex, fragment) {
    const made = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw Error(gl.getShaderInfoLog(shader));
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    return made;
  }
  const show = program(FLAT, SHOW);
  const size = gl.getUniformLocation(show, "size"), empty = gl.createVertexArray();

  /* What the painter draws into: colours times how much of the pixel is known, which is alpha. */
  const target = { painted: gl.createFramebuffer(), width: 0, height: 0 };
  /* Moving pictures have fewer pixels where the computer is slow; those at rest have all. */
  let coarser = 1, resting = 0;
  function resize() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2), scale = Math.min(1, 1280 / (canvas.clientWidth * ratio)) / coarser;
    const width = Math.max(2, Math.round(canvas.clientWidth * ratio * scale));
    const height = Math.max(2, Math.round(canvas.clientHeight * ratio * scale));
    if (width === target.width && height === target.height) return;
    Object.assign(target, { width, height });
    canvas.width = width;
    canvas.height = height;
    gl.deleteTexture(target.means || null);
    const levels = Math.floor(Math.log2(Math.max(width, height))) + 1;
    target.means = texture(levels, gl.RGBA8, gl.LINEAR_MIPMAP_NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.painted);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target.means, 0);
    painter.resize(width, height);
  }
  function texture(levels, format, filter, width = target.width, height = target.height) {
    const made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.texStorage2D(gl.TEXTURE_2D, levels, format, width, height);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, filter);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filter === gl.NEAREST ? gl.NEAREST : gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    return made;
  }
  const painter = makePainter({ gl, data, program, texture, empty, FLAT });

  /* Only a few instants stay in the GPU's memory. */
  const held = new Map();
  function moment(number) {
    if (held.has(number)) {
      const found = held.get(number);
      held.delete(number);
      held.set(number, found);
      return found;
    }
    const made = painter.build(data.instants[number]);
    held.set(number, made);
    if (held.size > data.held) {
      const [oldest, gone] = held.entries().next().value;
      held.delete(oldest);
      gone.then(painter.free);
    }
    return made;
  }

  /* ---- The eye: a place on the rig's own surface, and how near ---- */
  const eye = { across: 0, down: 0, nearer: 0 };
  const add = (a, b, s) => a.map((x, k) => x + s * b[k]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = a => a.map(x => x / Math.hypot(...a));
  function place() {
    const { subject, right, down, ahead, distance, middle, half } = data.path;
    const a = middle[0] + eye.across * half[0], b = middle[1] + eye.down * half[1];
    let outwards = right.map(x => x * Math.sin(a) * Math.cos(b));
    outwards = add(add(outwards, down, Math.sin(b)), ahead, -Math.cos(a) * Math.cos(b));
    return add(subject, outwards, distance * (1 - eye.nearer));
  }
  function camera(from) {
    const { subject, spot, scale, distance } = data.path;
    const ahead = unit(add(subject, from, -1)), right = unit(cross(data.path.down, ahead)), down = cross(ahead, right);
    const wide = target.width, high = target.height, shape = data.path.shape;
    /* The picture fills a canvas of another shape, but for at most a third of its width or height. */
    const whole = Math.min(wide, high * shape), width = Math.min(Math.max(wide, high * shape), 1.5 * whole);
    const height = width / shape;
    const focal = scale * width * distance;
    const cx = (wide - width) / 2 + spot[0] * width, cy = (high - height) / 2 + spot[1] * height;
    const n = data.path.near, f = data.path.far;
    const rows = [
      right.map((x, k) => 2 * focal / wide * x + (2 * cx / wide - 1) * ahead[k]),
      down.map((x, k) => -2 * focal / high * x + (1 - 2 * cy / high) * ahead[k]),
      ahead.map(x => (f + n) / (f - n) * x),
      ahead,
    ];
    const shift = rows.map(row => -dot(row, from));
    shift[2] -= 2 * f * n / (f - n);
    const matrix = new Float32Array(16);
    rows.forEach((row, j) => { row.forEach((x, k) => { matrix[4 * k + j] = x; }); matrix[12 + j] = shift[j]; });
    return { from, matrix, right, down, ahead, focal, cx, cy };
  }

  let now = 0, shown = null, waiting = false, drawn = 0;
  const sharpen = () => { const usual = coarser; coarser = 1; draw(); coarser = usual; };
  function drawMoving() {
    const begun = performance.now();
    draw();
    clearTimeout(resting);
    if (coarser > 1) resting = setTimeout(sharpen, 250);
    requestAnimationFrame(() => {
      const took = performance.now() - begun;
      if (took > 40) coarser = Math.min(3, coarser * 1.25);
      if (took < 18) coarser = Math.max(1, coarser / 1.25);
    });
  }
  function draw() {
    waiting = false;
    if (!shown) return;
    resize();
    gl.viewport(0, 0, target.width, target.height);
    painter.draw(shown, camera(place()), target, coarser ** -1.5);
    gl.bindVertexArray(empty);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.useProgram(show);
    gl.uniform2f(size, target.width, target.height);
    gl.bindTexture(gl.TEXTURE_2D, target.means);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    drawn++;
    stage.classList.add("live");
  }
  const redraw = () => { if (!waiting) { waiting = true; requestAnimationFrame(drawMoving); } };
  async function go(number) {
    now = number;
    const made = await moment(number);
    if (now !== number) return;
    shown = made;
    redraw();
  }

  /* ---- Controls ---- */
  const limit = (x, most) => Math.min(Math.max(x, -most), most);
  function move(across, down, nearer = 0) {
    eye.across = limit(eye.across + across, data.path.limits[0]);
    eye.down = limit(eye.down + down, data.path.limits[1]);
    eye.nearer = Math.min(Math.max(eye.nearer + nearer, -0.4), 0.35);
    redraw();
  }
  const swing = document.getElementById("swing");
  let swinging = false, first = 0;
  function setSwinging(on) {
    clearTimeout(first);
    swinging = on;
    swing.setAttribute("aria-pressed", String(on));
    const begun = performance.now() - 4000 / (2 * Math.PI) * Math.asin(limit(eye.across / .9, 1));
    const step = time => {
      if (!swinging) return;
      eye.across = .9 * Math.sin(2 * Math.PI * (time - begun) / 4000);
      eye.down *= .95;
      drawMoving();
      requestAnimationFrame(step);
    };
    if (on) requestAnimationFrame(step);
  }
  const fingers = new Map();
  const apart = () => { const [a, b] = fingers.values(); return Math.hypot(a.x - b.x, a.y - b.y); };
  canvas.addEventListener("pointerdown", event => {
    setSwinging(false);
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener("pointermove", event => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const wide = fingers.size === 2 ? apart() : 0;
    const here = { x: event.clientX, y: event.clientY };
    fingers.set(event.pointerId, here);
    if (wide) move(0, 0, (apart() - wide) / canvas.clientWidth);
    else move(-3 * (here.x - before.x) / canvas.clientWidth, -3 * (here.y - before.y) / canvas.clientHeight);
  });
  for (const end of ["pointerup", "pointercancel"])
    canvas.addEventListener(end, event => fingers.delete(event.pointerId));
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    setSwinging(false);
    move(0, 0, -event.deltaY / 2000);
  }, { passive: false });
  const keys = { ArrowLeft: [-.1, 0], ArrowRight: [.1, 0], ArrowUp: [0, -.1], ArrowDown: [0, .1], "+": [0, 0, .05],
    "-": [0, 0, -.05] };
  canvas.addEventListener("keydown", event => {
    if (!keys[event.key]) return;
    event.preventDefault();
    setSwinging(false);
    move(...keys[event.key]);
  });
  swing.addEventListener("click", () => setSwinging(!swinging));
  document.getElementById("middle").addEventListener("click", () => {
    setSwinging(false);
    Object.assign(eye, { across: 0, down: 0, nearer: 0 });
    redraw();
  });
  canvas.addEventListener("webglcontextlost", () => stage.classList.remove("live"));
  new ResizeObserver(redraw).observe(canvas);

  const slider = document.getElementById("at"), output = document.getElementById("now");
  const play = document.getElementById("play");
  if (data.instants.length > 1) {
    document.getElementById("time").hidden = false;
    slider.max = data.instants.length - 1;
    const label = () => { output.textContent = `instant ${data.instants[slider.value].instant}`; };
    slider.addEventListener("input", () => { label(); go(+slider.value); });
    label();
    let timer = 0;
    const next = async () => {
      slider.value = (+slider.value + 1) % data.instants.length;
      label();
      const begun = performance.now();
      await go(+slider.value);
      if (timer) timer = setTimeout(next, Math.max(0, data.step_ms - (performance.now() - begun)));
    };
    play.addEventListener("click", () => {
      timer = timer ? (clearTimeout(timer), 0) : setTimeout(next, 0);
      play.setAttribute("aria-pressed", String(Boolean(timer)));
    });
  }
  document.getElementById("controls").hidden = false;
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  /* The first sight is at rest, with all pixels: moving pictures have fewer where the computer is slow. */
  go(0).then(() => { if (!still) first = setTimeout(setSwinging, 1500, true); });
  /* For tests: the eye's place, and how many pictures were drawn. */
  window.walk = { eye, draw: sharpen, coarse: () => coarser, count: () => drawn, stop: () => setSwinging(false) };
})();
