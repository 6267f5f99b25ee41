"use strict";
document.documentElement.classList.add("js");

for (const range of document.querySelectorAll(".wipe")) {
  const pair = range.closest(".pair");
  const show = () => {
    pair.style.setProperty("--at", range.value + "%");
    range.setAttribute("aria-valuetext", `${range.value} % ${range.dataset.left}`);
  };
  range.addEventListener("input", show);
  show();
}

for (const choice of document.querySelectorAll("input[name=view]")) {
  const apply = () => {
    if (choice.checked) document.documentElement.classList.toggle("beside", choice.value === "beside");
  };
  choice.addEventListener("change", apply);
  apply();
}

// What scrolls sideways can be scrolled by keys.
const reach = () => {
  for (const wide of document.querySelectorAll(".wide")) {
    if (wide.scrollWidth > wide.clientWidth) wide.tabIndex = 0;
    else wide.removeAttribute("tabindex");
  }
};
addEventListener("resize", reach);
addEventListener("toggle", reach, true);
reach();

// The bullet-time sweep: both reels show the same camera; plays there and back until somebody steps.
const still = matchMedia("(prefers-reduced-motion: reduce)");
for (const sweep of document.querySelectorAll(".sweep")) {
  const reels = [...sweep.querySelectorAll(".reel")].map((reel) => [...reel.children]);
  const late = sweep.querySelector(".offset .now");
  const range = sweep.querySelector(".at");
  const button = sweep.querySelector(".play");
  const where = sweep.querySelector(".where");
  const last = reels[0].length - 1;
  let now = 0, way = 1, playing = false, inView = true, timer = 0;

  const show = (next) => {
    const before = now;
    now = Math.max(0, Math.min(last, next));
    for (const reel of reels) {
      reel.forEach((frame, k) => {
        frame.classList.toggle("on", k === now);
        frame.classList.toggle("was", k === before && k !== now);
      });
    }
    const { camera, time } = reels[1][now].dataset;
    late.textContent = `: ${time}`;
    where.textContent = `${camera} (${now + 1} of ${last + 1})`;
    range.value = now;
    range.setAttribute("aria-valuetext", `${camera}; unsynchronized: ${time}`);
  };
  const wait = () => {
    clearTimeout(timer);
    if (playing && inView) timer = setTimeout(turn, now === 0 || now === last ? 900 : 350);
  };
  const turn = () => {
    if (now + way < 0 || now + way > last) way = -way;
    show(now + way);
    wait();
  };
  const play = (on) => {
    playing = on;
    button.textContent = on ? "Pause" : "Play";
    wait();
  };

  button.addEventListener("click", () => play(!playing));
  range.addEventListener("input", () => { play(false); show(Number(range.value)); });
  for (const step of sweep.querySelectorAll(".step")) {
    step.addEventListener("click", () => { play(false); show(now + Number(step.dataset.step)); });
  }
  for (const reel of sweep.querySelectorAll(".reel")) {
    const drag = (event) => {
      if (!event.buttons) return;
      const box = reel.getBoundingClientRect();
      play(false);
      show(Math.floor(((event.clientX - box.left) / box.width) * (last + 1)));
    };
    reel.addEventListener("pointerdown", drag);
    reel.addEventListener("pointermove", drag);
    reel.addEventListener("dragstart", (event) => event.preventDefault());
  }
  const seen = (entries) => { inView = entries.at(-1).isIntersecting; wait(); };
  new IntersectionObserver(seen).observe(sweep);
  show(0);
  play(!still.matches);
}
