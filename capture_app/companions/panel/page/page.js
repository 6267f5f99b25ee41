// Main script: counts refreshes, draws the panel at each one's number, and reports the status.
const part = (id) => document.getElementById(id);
const panels = JSON.parse(part("panels").textContent);
const counter = new RefreshCounter();
const drawing = new Drawing(part("panel"), panels.layout, panels.screens, panels.scan_share);
// Fraction of the scan extent assumed by the reader below which the page recommends full screen.
const SHORT = 0.85;
let placed = false;
let saidAt = -Infinity;

// Scan direction in the current orientation: a phone's rotates with the phone.
function way() {
  const chosen = part("scan").value;
  if (chosen !== "auto") return chosen;
  return { 0: "down", 90: "right", 180: "up", 270: "left" }[screen.orientation?.angle ?? 0] ?? "down";
}

function size() {
  let sides = [screen.width, screen.height];
  const wide = screen.orientation?.type.startsWith("landscape");
  // Some phones report the sides of the upright orientation.
  if (wide !== undefined && wide !== sides[0] >= sides[1]) sides = sides.reverse();
  const [width, height] = [innerWidth, innerHeight];
  return {
    width,
    height,
    screen_width: Math.max(sides[0], width),
    screen_height: Math.max(sides[1], height),
    density: devicePixelRatio,
  };
}

function say() {
  let text = "measuring the screen …";
  let trouble = false;
  if (document.hidden) return;
  if (counter.number === null) {
    if (counter.problem) [text, trouble] = [`no time code: ${counter.problem}; measuring again …`, true];
  } else {
    const rate = 1000 / counter.period;
    if (!drawing.panel) {
      const known = [...new Set(panels.screens.map((one) => one.rate_hz))].join(", ");
      [text, trouble] = [`no time code: there is none for ${rate.toFixed(1)} Hz (but for ${known})`, true];
    } else {
      text = `${rate.toFixed(2)} Hz · ${counter.missed} missed · a refresh is ${counter.period.toFixed(2)} ms`;
      if (drawing.share < SHORT * panels.scan_share) text += " · full screen is more accurate";
      text += ` · ${drawing.panel.name}`;
    }
  }
  part("status").textContent = text;
  document.documentElement.classList.toggle("trouble", trouble);
}

function frame(timestamp) {
  requestAnimationFrame(frame);
  const number = counter.take(timestamp, performance.now());
  if (number === null) placed = false;
  else if (!placed) {
    drawing.place(1000 / counter.period, way(), size());
    placed = true;
  }
  drawing.show(number);
  if (timestamp - saidAt > 500) {
    saidAt = timestamp;
    say();
  }
}

function moved() {
  placed = false;
  drawing.clear();
}

async function stayAwake() {
  let words = "The screen is kept awake while this page is seen.";
  try {
    await navigator.wakeLock.request("screen");
  } catch {
    words = "This browser does not let the page keep the screen awake (over the network, few do): set the screen to stay on.";
  }
  part("awake").textContent = words;
}

function toggleFull() {
  const root = document.documentElement;
  if (document.fullscreenElement) document.exitFullscreen();
  else root.requestFullscreen?.({ navigationUI: "hide" }).catch(() => {});
}

addEventListener("resize", moved);
screen.orientation?.addEventListener("change", moved);
part("scan").addEventListener("change", moved);
part("full").hidden = !document.documentElement.requestFullscreen;
part("full").addEventListener("click", toggleFull);
part("panel").addEventListener("dblclick", toggleFull);
part("help").addEventListener("click", () => part("about").showModal());
addEventListener("keydown", (event) => {
  if (event.key === "f" && !event.ctrlKey && !event.metaKey && !event.altKey) toggleFull();
});
document.addEventListener("visibilitychange", () => {
  if (document.hidden) return;
  // A hidden page gets no callbacks, and its line may be wrong now.
  counter.begin();
  stayAwake();
});
stayAwake();
requestAnimationFrame(frame);
