"use strict";
/* Textured meshes of all cameras' depth, blended by the direction of view, for `walk.js`. */
function makePainter({ gl, data, program, texture, empty, FLAT }) {
  const floats = gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float");
  const MESH = `#version 300 es
  layout(location = 0) in vec3 point; layout(location = 1) in vec2 spot;
  uniform mat4 view; uniform float nearer; uniform vec3 eye, camera;
  out vec2 place; out float weight;
  void main() {
    vec3 to_eye = normalize(point - eye), to_camera = normalize(point - camera);
    float angle = 2.0 * (1.0 - dot(to_eye, to_camera)) / 0.0064;
    /* Half floats still hold the weight of a camera on the other side. */
    weight = exp(-min(angle, 30.0)) + max(1e-3 / (1.0 + angle), 1e-4);
    place = spot;
    gl_Position = view * vec4(eye + (point - eye) * nearer, 1.0);
  }`;
  const PAINT = `#version 300 es
  precision highp float;
  uniform sampler2D picture; in vec2 place; in float weight; out vec4 colour;
  void main() { colour = vec4(texture(picture, place).rgb, 1.0) * weight; }`;
  const MEAN = `#version 300 es
  precision highp float;
  uniform sampler2D sums; out vec4 colour;
  void main() {
    vec4 sum = texelFetch(sums, ivec2(gl_FragCoord.xy), 0);
    colour = sum.a > 1e-5 ? vec4(sum.rgb / sum.a, 1.0) : vec4(0.0);
  }`;
  const mesh = program(MESH, PAINT), mean = program(FLAT, MEAN);
  const at = name => gl.getUniformLocation(mesh, name);
  const places = { view: at("view"), nearer: at("nearer"), eye: at("eye"), camera: at("camera") };

  /* Sums of weighted colours, and the depth of the nearest surface. */
  const own = { painted: gl.createFramebuffer() };
  function resize(width, height) {
    gl.deleteTexture(own.sums || null);
    gl.deleteRenderbuffer(own.depth || null);
    own.sums = texture(1, floats ? gl.RGBA16F : gl.RGBA8, gl.NEAREST);
    own.depth = gl.createRenderbuffer();
    gl.bindRenderbuffer(gl.RENDERBUFFER, own.depth);
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, own.painted);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, own.sums, 0);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, own.depth);
  }

  /* ---- Meshes: the pixels of a camera's depth, without triangles across an edge ---- */
  async function load(address) {
    const image = new Image();
    image.src = address;
    await image.decode();
    return image;
  }
  function depths(image, near, far) {
    const flat = document.createElement("canvas");
    flat.width = image.width;
    flat.height = image.height;
    const context = flat.getContext("2d", { willReadFrequently: true });
    context.drawImage(image, 0, 0);
    const bytes = context.getImageData(0, 0, image.width, image.height).data;
    const found = new Float32Array(image.width * image.height);
    for (let i = 0; i < found.length; i++) {
      const level = (bytes[4 * i] << 4) | (bytes[4 * i + 1] >> 4);
      if (level) found[i] = 1 / (1 / far + (level - 1) / 4094 * (1 / near - 1 / far));
    }
    return found;
  }
  /* Where each corner is in the map, px: those on an edge are moved towards their neighbours on it, so that the
   * edge has no steps. */
  function smoothed(depth, wide, high, triangles) {
    const around = new Uint8Array(depth.length), at = new Float32Array(2 * depth.length);
    for (const i of triangles) around[i]++;
    for (let i = 0; i < depth.length; i++) { at[2 * i] = i % wide; at[2 * i + 1] = Math.floor(i / wide); }
    /* Every second round back again, a little farther: thin parts hardly shrink (Taubin 1995). */
    for (const step of [.5, -.53, .5, -.53]) {
      const before = at.slice();
      for (let y = 1; y + 1 < high; y++)
        for (let x = 1; x + 1 < wide; x++) {
          const i = y * wide + x;
          /* Six triangles meet in a corner inside a surface. */
          if (!around[i] || around[i] === 6) continue;
          let sums = [0, 0, 0];
          for (const j of [i - 1, i + 1, i - wide - 1, i - wide, i - wide + 1, i + wide - 1, i + wide, i + wide + 1]) {
            const apart = Math.max(depth[i], depth[j]) < data.edge * Math.min(depth[i], depth[j]);
            if (around[j] && around[j] < 6 && apart) sums = [sums[0] + before[2 * j], sums[1] + before[2 * j + 1], sums[2] + 1];
          }
          if (sums[2]) for (let k = 0; k < 2; k++) at[2 * i + k] += step * (sums[k] / sums[2] - before[2 * i + k]);
        }
    }
    return at;
  }
  async function meshOf(seen, camera) {
    const [picture, map] = await Promise.all([load(seen.picture), load(seen.depth)]);
    const wide = map.width, high = map.height, depth = depths(map, seen.near, seen.far);
    const [fx, fy, cx, cy] = camera.lens, r = camera.rotation, c = camera.centre;
    const triangles = [];
    const whole = (a, b, e) => {
      const p = depth[a], q = depth[b], s = depth[e];
      return p && q && s && Math.max(p, q, s) < data.edge * Math.min(p, q, s);
    };
    for (let y = 0; y + 1 < high; y++)
      for (let x = 0; x + 1 < wide; x++) {
        const i = y * wide + x;
        if (whole(i, i + 1, i + wide)) triangles.push(i, i + 1, i + wide);
        if (whole(i + 1, i + wide, i + wide + 1)) triangles.push(i + 1, i + wide, i + wide + 1);
      }
    const across = smoothed(depth, wide, high, triangles), vertices = new Float32Array(5 * wide * high);
    for (let i = 0; i < depth.length; i++) {
      const x = across[2 * i] + .5, y = across[2 * i + 1] + .5;
      const d = depth[i], u = (x * camera.width / wide - .5 - cx) / fx * d;
      const v = (y * camera.height / high - .5 - cy) / fy * d;
      for (let k = 0; k < 3; k++) vertices[5 * i + k] = c[k] + r[k] * u + r[3 + k] * v + r[6 + k] * d;
      vertices[5 * i + 3] = x / wide;
      vertices[5 * i + 4] = y / high;
    }
    const made = { array: gl.createVertexArray(), count: triangles.length, centre: c, texture: gl.createTexture() };
    made.buffers = [gl.createBuffer(), gl.createBuffer()];
    gl.bindVertexArray(made.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, made.buffers[0]);
    gl.bufferData(gl.ARRAY_BUFFER, vertices, gl.STATIC_DRAW);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, made.buffers[1]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(triangles), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 20, 0);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 2, gl.FLOAT, false, 20, 12);
    gl.bindVertexArray(null);
    gl.bindTexture(gl.TEXTURE_2D, made.texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, picture);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    return made;
  }
  const build = instant => Promise.all(instant.cameras.map(one => meshOf(one, data.cameras[one.camera])));
  const free = meshes => meshes.forEach(one => {
    gl.deleteVertexArray(one.array);
    gl.deleteTexture(one.texture);
    one.buffers.forEach(buffer => gl.deleteBuffer(buffer));
  });
  function draw(meshes, camera, { painted }) {
    gl.bindFramebuffer(gl.FRAMEBUFFER, own.painted);
    gl.useProgram(mesh);
    gl.uniformMatrix4fv(places.view, false, camera.matrix);
    gl.uniform3fv(places.eye, camera.from);
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true);
    gl.colorMask(true, true, true, true);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    /* First the nearest surface, then the colours of all that are hardly behind it. */
    for (const first of [true, false]) {
      gl.colorMask(!first, !first, !first, !first);
      gl.depthMask(first);
      gl.uniform1f(places.nearer, first ? 1 : 1 - data.tolerance);
      if (!first) { gl.enable(gl.BLEND); gl.blendFunc(gl.ONE, gl.ONE); }
      for (const one of meshes) {
        gl.uniform3fv(places.camera, one.centre);
        gl.bindTexture(gl.TEXTURE_2D, one.texture);
        gl.bindVertexArray(one.array);
        gl.drawElements(gl.TRIANGLES, one.count, gl.UNSIGNED_INT, 0);
      }
    }
    gl.disable(gl.BLEND);
    gl.disable(gl.DEPTH_TEST);
    gl.bindVertexArray(empty);
    gl.bindFramebuffer(gl.FRAMEBUFFER, painted);
    gl.useProgram(mean);
    gl.bindTexture(gl.TEXTURE_2D, own.sums);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
  return { resize, build, free, draw };
}
