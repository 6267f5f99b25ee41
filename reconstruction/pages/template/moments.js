"use strict";
/* Moments to walk round: time, swinging, and what stays in the GPU's memory. */
(() => {
  const data = JSON.parse(document.getElementById("moments").textContent);
  const walk = makeWalk(document.getElementById("canvas"), data, makePainter, () => setSwinging(false));
  if (!walk) {
    document.getElementById("hint").textContent =
      "This browser shows no 3D (WebGL 2), so here is the view from the middle of the rig.";
    return;
  }

  /* Only a few instants stay in the GPU's memory. */
  const held = new Map();
  function moment(number) {
    if (held.has(number)) {
      const found = held.get(number);
      held.delete(number);
      held.set(number, found);
      return found;
    }
    const made = walk.painter.build(data.instants[number]);
    held.set(number, made);
    if (held.size > data.held) {
      const [oldest, gone] = held.entries().next().value;
      held.delete(oldest);
      gone.then(walk.painter.free);
    }
    return made;
  }
  let now = 0;
  async function go(number) {
    now = number;
    const made = await moment(number);
    if (now === number) walk.show(made);
  }

  const swing = document.getElementById("swing"), { eye } = walk;
  let swinging = false, first = 0;
  function setSwinging(on) {
    clearTimeout(first);
    swinging = on;
    swing.setAttribute("aria-pressed", String(on));
    const begun = performance.now() - 4000 / (2 * Math.PI) * Math.asin(Math.min(Math.max(eye.across / .9, -1), 1));
    const step = time => {
      if (!swinging) return;
      eye.across = .9 * Math.sin(2 * Math.PI * (time - begun) / 4000);
      eye.down *= .95;
      walk.drawMoving();
      requestAnimationFrame(step);
    };
    if (on) requestAnimationFrame(step);
  }
  swing.addEventListener("click", () => setSwinging(!swinging));
  document.getElementById("middle").addEventListener("click", () => {
    setSwinging(false);
    walk.goToMiddle();
  });

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
  /* For tests. */
  window.walk = { ...walk, stop: () => setSwinging(false) };
})();
