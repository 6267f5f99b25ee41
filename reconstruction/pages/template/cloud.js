// The cloud: drawn point by point with a depth of each pixel, so that it takes no library and no GPU.
for (const figure of document.querySelectorAll(".cloud")) {
  const canvas = figure.querySelector("canvas");
  const pen = canvas.getContext("2d");
  const wide = canvas.width, high = canvas.height;
  const picture = pen.createImageData(wide, high);
  const pixels = new Uint32Array(picture.data.buffer);
  const depths = new Float32Array(wide * high);
  const numbers = (text) => text.split(" ").map(Number);
  const pivot = numbers(canvas.dataset.pivot);
  const home = Math.hypot(...pivot);

  const unpack = (side) => {
    const bytes = Uint8Array.from(atob(canvas.dataset[side]), (letter) => letter.charCodeAt(0));
    const count = bytes.length / 9;
    const places = new DataView(bytes.buffer);
    const middle = numbers(canvas.dataset[side + "Middle"]), step = Number(canvas.dataset[side + "Step"]);
    const points = new Float32Array(3 * count), colours = new Uint32Array(count), sizes = new Float32Array(count);
    for (let k = 0; k < 3 * count; k++) {
      points[k] = middle[k % 3] + step * places.getInt16(2 * k, true) - pivot[k % 3];
    }
    // Points lie as dense as pixels: seen from where they were taken, each fills its own gap.
    for (let k = 0; k < count; k++) {
      const at = 6 * count + 3 * k;
      sizes[k] = 1.6 * Math.sqrt((wide * high) / count) * (points[3 * k + 2] + pivot[2]);
      colours[k] = 0xff000000 | (bytes[at + 2] << 16) | (bytes[at + 1] << 8) | bytes[at];
    }
    return { count, points, colours, sizes };
  };
  const clouds = { synced: unpack("synced"), offset: canvas.dataset.offset && unpack("offset") };
  let side = "synced", yaw = 0, pitch = 0, near = 1, due = false, swinging = !still.matches, began = 0;

  const draw = () => {
    due = false;
    const { count, points, colours, sizes } = clouds[side];
    const focal = Number(canvas.dataset.focal) * wide;
    const cy = Math.cos(yaw), sy = Math.sin(yaw), cp = Math.cos(pitch), sp = Math.sin(pitch);
    // From behind the camera, in its direction: so all of its picture is in view.
    const [ax, ay, az] = pivot.map((value) => (1.15 * value) / near);
    const nearest = 0.05 * home;
    pixels.fill(0xff1c1e22);
    depths.fill(Infinity);
    for (let k = 0; k < count; k++) {
      const x0 = points[3 * k], y0 = points[3 * k + 1], z0 = points[3 * k + 2];
      const z1 = cy * z0 - sy * x0, z = sp * y0 + cp * z1 + az;
      if (z < nearest) continue;
      const size = Math.max(1, Math.min(24, (sizes[k] / z + 0.5) | 0)), scale = focal / z;
      const left = (wide / 2 + scale * (cy * x0 + sy * z0 + ax) - size / 2 + 0.5) | 0;
      const top = (high / 2 + scale * (cp * y0 - sp * z1 + ay) - size / 2 + 0.5) | 0;
      if (left < 0 || top < 0 || left + size > wide || top + size > high) continue;
      const colour = colours[k];
      for (let row = top * wide + left, end = row + size * wide; row < end; row += wide) {
        for (let at = row; at < row + size; at++) {
          if (z < depths[at]) { depths[at] = z; pixels[at] = colour; }
        }
      }
    }
    pen.putImageData(picture, 0, 0);
    canvas.dataset.drawn = `${side} ${yaw.toFixed(3)} ${pitch.toFixed(3)} ${near.toFixed(2)}`;
  };
  const redraw = () => { if (!due) { due = true; requestAnimationFrame(draw); } };
  const turn = (right, down) => {
    swinging = false;
    yaw += right;
    pitch = Math.max(-1.4, Math.min(1.4, pitch + down));
    redraw();
  };
  const approach = (times) => {
    swinging = false;
    near = Math.max(0.4, Math.min(5, near * times));
    redraw();
  };
  const keys = {
    ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0),
    ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1),
    "+": () => approach(1.15), "=": () => approach(1.15), "-": () => approach(1 / 1.15),
  };
  canvas.addEventListener("keydown", (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    keys[event.key]();
  });
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons) turn(event.movementX * 0.008, -event.movementY * 0.008);
  });
  for (const choice of figure.querySelectorAll("input")) {
    choice.addEventListener("change", () => { side = choice.value; redraw(); });
  }
  // It swings to both sides until somebody takes it: that it has depth is seen at once.
  const swing = (now) => {
    if (!swinging || !inView) return;
    began ||= now;
    const angle = Math.min((now - began) / 1600, 4 * Math.PI);
    swinging = angle < 4 * Math.PI;
    yaw = 0.3 * Math.sin(angle);
    draw();
    requestAnimationFrame(swing);
  };
  let inView = false;
  new IntersectionObserver((entries) => {
    inView = entries.at(-1).isIntersecting;
    if (inView) requestAnimationFrame(swing);
  }).observe(canvas);
  draw();
}
