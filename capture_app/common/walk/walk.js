"use strict";
/* Walks round a scene on a canvas: the place of the eye, fingers and keys, and what no camera saw. `makePainter` draws the
 * scene; `data.path` has the places to look from, in rig coordinates: x right, y down. A painter that covers the whole
 * picture (`data.whole`) is shown as it is. The canvas' parent is `live` once something is drawn. `onTouch` is called when
 * a person moves the eye. Returns null if the browser has no WebGL 2. */
function makeWalk(canvas, data, makePainter, onTouch) {
  const gl = canvas.getContext("webgl2", { antialias: Boolean(data.whole), alpha: false });
  if (!gl) return null;

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
  const target = { painted: data.whole ? null : gl.createFramebuffer(), width: 0, height: 0 };
  /* Moving pictures have fewer pixels where the computer is slow; those at rest have all. */
  let coarser = 1, resting = 0;
  function resize() {
    const device = window.devicePixelRatio || 1, ratio = data.whole ? device : Math.min(device, 2);
    const scale = (data.whole ? 1 : Math.min(1, 1280 / (canvas.clientWidth * ratio))) / coarser;
    const width = Math.max(2, Math.round(canvas.clientWidth * ratio * scale));
    const height = Math.max(2, Math.round(canvas.clientHeight * ratio * scale));
    if (width === target.width && height === target.height) return;
    Object.assign(target, { width, height });
    canvas.width = width;
    canvas.height = height;
    if (!data.whole) {
      gl.deleteTexture(target.means || null);
      const levels = Math.floor(Math.log2(Math.max(width, height))) + 1;
      target.means = texture(levels, gl.RGBA8, gl.LINEAR_MIPMAP_NEAREST);
      gl.bindFramebuffer(gl.FRAMEBUFFER, target.painted);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target.means, 0);
    }
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

  let shown = null, waiting = false, drawn = 0;
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
    if (!data.whole) fill();
    drawn++;
    canvas.parentElement.classList.add("live");
  }
  function fill() {
    gl.bindVertexArray(empty);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.useProgram(show);
    gl.uniform2f(size, target.width, target.height);
    gl.bindTexture(gl.TEXTURE_2D, target.means);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
  const redraw = () => { if (!waiting) { waiting = true; requestAnimationFrame(drawMoving); } };

  /* ---- Fingers and keys ---- */
  const limit = (x, most) => Math.min(Math.max(x, -most), most);
  function move(across, down, nearer = 0) {
    onTouch();
    eye.across = limit(eye.across + across, data.path.limits[0]);
    eye.down = limit(eye.down + down, data.path.limits[1]);
    eye.nearer = Math.min(Math.max(eye.nearer + nearer, -0.4), 0.35);
    redraw();
  }
  const fingers = new Map();
  const apart = () => { const [a, b] = fingers.values(); return Math.hypot(a.x - b.x, a.y - b.y); };
  canvas.addEventListener("pointerdown", event => {
    onTouch();
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
    move(0, 0, -event.deltaY / 2000);
  }, { passive: false });
  const keys = { ArrowLeft: [-.1, 0], ArrowRight: [.1, 0], ArrowUp: [0, -.1], ArrowDown: [0, .1], "+": [0, 0, .05],
    "-": [0, 0, -.05] };
  canvas.addEventListener("keydown", event => {
    if (!keys[event.key]) return;
    event.preventDefault();
    move(...keys[event.key]);
  });
  canvas.addEventListener("webglcontextlost", () => canvas.parentElement.classList.remove("live"));
  new ResizeObserver(data.whole ? sharpen : redraw).observe(canvas);

  /* Shows a built moment, in fewer pixels where the computer is slow; `showNow` in all, unless a finger moves the eye. */
  const showMoment = moment => { shown = moment; redraw(); };
  const showNow = moment => { shown = moment; (fingers.size ? redraw : sharpen)(); };
  const goToMiddle = () => { Object.assign(eye, { across: 0, down: 0, nearer: 0 }); redraw(); };
  return { eye, painter, show: showMoment, showNow, goToMiddle, drawMoving, draw: sharpen, coarse: () => coarser,
    count: () => drawn };
}
