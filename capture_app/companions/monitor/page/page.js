// User interface of the monitor: live pictures, the take button, and the last take.
"use strict";
const seen = id => document.getElementById(id);
const STATES = {joining: "joining", syncing: "clock …", aligning: "aligning …", lost: "lost", failed: "stopped"};
const GOOD = ["ready", "coarse"];
const MIN_TILE_PX = 104, GAP_PX = 6, SILENT_MS = 10_000;
// A picture says how old it is once it is older than the rig allows, or than the newest beside it.
let oldS = Infinity, apartS = Infinity;
const tiles = new Map();
// Why a picture of a take is absent. The server says it once, also to monitors that did not ask for it.
const reasons = new Map();
let aspect = 0.75;
const settings = {mode: "burst", frames: "8", countdown: "0", motion: "", ...JSON.parse(memory.get("settings") || "{}")};
let closeUp = "", kind = "sheet", take = null, course = {state: "idle"}, burst = null, rigLost = "", shownTake = null, refused = "";
// A burst's images may arrive long after its last frame, when the people in front of the cameras may move again.
const LEAD_S = 1;
let isTaken = false, taking = 0;

const link = new Link({
  onOpen() {
    document.body.classList.remove("off");
    if (closeUp) link.say("look", {camera: closeUp});
    askForPeople();
    openPicture();
  },
  onMessage(message) { SHOW[message.type](message); },
  onPicture(key, bytes) {
    const [where, ...rest] = key.split("/"), name = rest.join("/");
    if (where === "live") decoding.push(decoded(name, bytes));
    else drawTake(key, bytes);
  },
  onLost(words, isRefused) {
    document.body.className = "off";
    seen("state").textContent = isRefused ? "Not let in" : "Disconnected";
    seen("advice").textContent = words;
    showCourse();
  },
});

const SHOW = {
  live({ages_s: ages}) { showTogether(ages); },
  people(message) { if (people.isShown) showPeople(message); },
  lost({reason}) { rigLost = reason; showState(); },
  rig(rig) {
    seen("advice").dataset.rig = rig.advice;
    [oldS, apartS] = [rig.old_s, rig.apart_s];
    const here = new Set(rig.cameras.map(camera => camera.name));
    for (const [name, tile] of tiles) if (!here.has(name)) { tile.box.remove(); tiles.delete(name); }
    for (const [place, camera] of rig.cameras.entries()) {
      const tile = tiles.get(camera.name) || addTile(camera);
      tile.camera = camera;
      tile.box.className = `camera ${camera.state}${closeUp === camera.name ? " close" : ""}`;
      tile.box.title = camera.message;
      tile.box.style.order = place;
      if (!tile.box.parentNode) seen("cameras").append(tile.box);
    }
    fitTiles();
    showAges();
    showState();
  },
  burst(message) {
    if (!burst || burst.name !== message.name) {
      isTaken = false;
      clearTimeout(taking);
      taking = setTimeout(() => { isTaken = true; showCourse(); }, (message.seconds + LEAD_S) * 1000);
    }
    burst = message;
    showCourse();
  },
  course(message) { course = message; refused = ""; showCourse(); },
  refused({words}) { refused = words; showCourse(); },
  take(message) {
    const isNew = !take || take.name !== message.name;
    take = message;
    seen("take-name").textContent = seen("last-name").textContent = take.name;
    seen("grade").textContent = take.grade === "unknown" ? "" : take.grade;
    seen("grade").className = take.grade;
    seen("verdict").textContent = take.words.replace(`${take.grade}: `, "");
    seen("kinds").hidden = !take.has_pictures;
    seen("last").disabled = false;
    if (isNew) { kind = "sheet"; openPicture(); }
    showCourse();
  },
  absent(message) {
    reasons.set(message.picture, message);
    if (take && message.picture === takeKey()) { seen("picture").hidden = true; showAbsent(message); }
  },
};

// Cameras

function addTile({name, title}) {
  const box = document.createElement("button"), canvas = document.createElement("canvas"), line = document.createElement("p");
  const label = document.createElement("span"), said = document.createElement("span");
  box.type = "button";
  label.className = "name";
  label.textContent = title;
  said.className = "said";
  line.append(label, said);
  box.append(canvas, line);
  box.onclick = () => lookAt(closeUp === name ? "" : name);
  const tile = {box, canvas, said, camera: null, pictures: 0, moment: null};
  box.dataset.name = name;
  tiles.set(name, tile);
  return tile;
}

// Columns and width with which all cameras are in view, as large as possible; else two columns, and the page scrolls.
function fitTiles() {
  const main = seen("cameras"), style = getComputedStyle(main);
  const wide = main.clientWidth - parseFloat(style.paddingLeft) - parseFloat(style.paddingRight);
  const high = main.clientHeight - parseFloat(style.paddingTop) - parseFloat(style.paddingBottom);
  let best = 2, largest = 0;
  for (let columns = 1; columns <= tiles.size; columns++) {
    const rows = Math.ceil(tiles.size / columns), gaps = GAP_PX * (columns - 1);
    const width = Math.floor(Math.min((wide - gaps) / columns, (high - GAP_PX * (rows - 1)) / rows / aspect));
    if (width >= MIN_TILE_PX && width > largest) [best, largest] = [columns, width];
  }
  main.style.gridTemplateColumns = largest ? `repeat(${best}, ${largest}px)` : `repeat(${best}, minmax(0, 1fr))`;
}
new ResizeObserver(fitTiles).observe(seen("cameras"));

function lookAt(name) {
  for (const other of [closeUp, name]) if (tiles.has(other)) tiles.get(other).box.classList.toggle("close", other === name);
  closeUp = name;
  if (name) tiles.get(name).box.scrollIntoView({block: "nearest"});
  link.say("look", {camera: name});
}

// Pictures that are shown together, once the message after them has come.
let decoding = [];

async function decoded(name, bytes) {
  try { return [name, await createImageBitmap(new Blob([bytes]))]; } catch { return [name, null]; /* not a picture */ }
}

async function showTogether(ages) {
  const waiting = decoding, came = performance.now();
  decoding = [];
  const pictures = await Promise.all(waiting);
  // A hidden page draws nothing, so it acknowledges nothing and costs the link nothing.
  requestAnimationFrame(() => {
    for (const [name, picture] of pictures) drawLive(tiles.get(name), picture, came / 1000 - ages[name]);
    showAges();
    link.say("seen", {picture: "live"});
  });
}

function drawLive(tile, picture, moment) {
  if (!tile || !picture) { picture?.close(); return; }
  tile.moment = moment;
  if (tile.canvas.width !== picture.width || tile.canvas.height !== picture.height) {
    tile.canvas.width = picture.width;
    tile.canvas.height = picture.height;
    tile.box.style.aspectRatio = `${picture.width} / ${picture.height}`;
    aspect = Math.max(...[...tiles.values()].map(one => one.canvas.height / one.canvas.width));
    fitTiles();
  }
  tile.canvas.getContext("2d").drawImage(picture, 0, 0);
  tile.box.dataset.pictures = ++tile.pictures;
  picture.close();
}

const ago = age => age >= 120 ? `${Math.round(age / 60)} min ago` : `${age.toFixed(age < 1 ? 1 : 0)} s ago`;

function showAges() {
  const now = performance.now() / 1000, newest = Math.max(...[...tiles.values()].map(tile => tile.moment ?? -Infinity));
  for (const {box, camera, moment, said} of tiles.values()) {
    const age = now - moment, old = moment !== null && (age > oldS || newest - moment > apartS);
    box.classList.toggle("old", old);
    const state = !camera || GOOD.includes(camera.state) ? "" : STATES[camera.state] || camera.state;
    said.textContent = [state, old ? ago(age) : ""].filter(Boolean).join(", ");
  }
}
setInterval(() => {
  showAges();
  if (link.socket?.readyState === WebSocket.OPEN) showState();
}, 1000);

// A socket stays open for minutes after its network has gone; pictures of a ready camera come about once a second.
const isSilent = cameras => cameras.some(camera => GOOD.includes(camera.state)) && performance.now() - link.heard > SILENT_MS;
const lostWords = cameras => rigLost || (isSilent(cameras) ? "The monitor's server has not been heard for 10 s. Is this device still in the same WiFi?" : "");

function showState() {
  const cameras = [...tiles.values()].map(tile => tile.camera).filter(Boolean);
  const ready = cameras.filter(camera => GOOD.includes(camera.state)).length;
  const lost = lostWords(cameras);
  document.body.classList.toggle("off", Boolean(lost));
  document.body.classList.toggle("good", !lost && cameras.length > 0 && ready === cameras.length);
  const state = cameras.length === ready ? `${ready} ${ready === 1 ? "camera" : "cameras"} ready` : `${ready} of ${cameras.length} cameras ready`;
  seen("state").textContent = rigLost ? "No leader" : lost ? "No connection" : cameras.length ? state : "No cameras yet";
  seen("advice").textContent = lost || (seen("advice").dataset.rig || "").replace(`${state}, `, "");
  showCourse();
}

// The take

const isWaiting = () => ["ordered", "countdown", "waiting"].includes(course.state);
const isRecording = () => Boolean(burst && burst.is_recording);
const capital = words => words[0].toUpperCase() + words.slice(1);
const minutes = seconds => `${Math.floor(seconds / 60)}:${String(seconds % 60).padStart(2, "0")}`;

function showCourse() {
  const shutter = seen("shutter"), face = shutter.firstElementChild;
  const counts = course.state === "countdown", hurries = isWaiting() && course.can_hurry, stops = isRecording() || (isWaiting() && !counts && !hurries);
  seen("cancel").hidden = !hurries;
  shutter.disabled = document.body.classList.contains("off") || tiles.size === 0;
  shutter.className = counts ? "count" : stops ? "stop" : "";
  face.textContent = counts ? course.seconds : "";
  shutter.setAttribute("aria-label", hurries ? "Take at once" : isWaiting() ? "Cancel" : isRecording() ? "Stop the recording" : "Take");
  seen("plan").classList.toggle("unused", isWaiting() || isRecording());
  seen("clock").textContent = isRecording() ? minutes(burst.seconds) : "";
  const [mood, words] = courseWords();
  seen("course").className = mood;
  seen("course").textContent = words;
}

function courseWords() {
  if (refused) return ["bad", refused];
  if (course.state === "failed") return ["bad", course.words];
  if (document.body.classList.contains("off")) return ["", ""];
  if (course.state === "countdown") return ["wait", "Press to cancel"];
  if (course.state === "waiting") return ["wait", capital(course.words || "waiting …") + (course.can_hurry ? "; press to take at once" : "")];
  if (course.state === "ordered") return ["wait", capital(course.words || "ordered …")];
  if (isRecording()) return ["red", `Recording · ${burst.received} frames`];
  if (burst && !burst.is_done) return ["wait", burst.received ? `Saving ${burst.received} of ${burst.expected} images` : isTaken ? "Taken; waiting for the images" : "Taking …"];
  if (take) return ["", `${take.name}${take.grade === "unknown" ? "" : `: ${take.grade}`}`];
  return ["", tiles.size ? "Ready to take" : ""];
}

function plan() {
  const more = {countdown_s: Number(settings.countdown)};
  if (settings.motion) more.on_motion = [0, 0, 1, 1];
  return settings.mode === "video" ? {video: true, ...more} : {frames: Number(settings.frames), ...more};
}

seen("shutter").onclick = () => {
  refused = "";
  if (isWaiting() && course.can_hurry) link.say("take", {plan: plan()});
  else if (isWaiting() || isRecording()) link.say("stop");
  else { document.body.classList.remove("taken"); openPicture(); link.say("take", {plan: plan()}); }
};

seen("cancel").onclick = () => link.say("stop");

function showSettings() {
  for (const group of document.querySelectorAll("[data-setting]")) {
    for (const button of group.querySelectorAll("button")) {
      button.setAttribute("role", "radio");
      button.setAttribute("aria-checked", String(button.value === settings[group.dataset.setting]));
    }
  }
  seen("motion").setAttribute("aria-pressed", String(Boolean(settings.motion)));
  document.querySelector("[data-setting=frames]").style.visibility = settings.mode === "video" ? "hidden" : "";
  memory.set("settings", JSON.stringify(settings));
}

for (const group of document.querySelectorAll("[data-setting]")) {
  group.setAttribute("role", "radiogroup");
  group.onclick = event => {
    if (!event.target.value) return;
    settings[group.dataset.setting] = event.target.value;
    showSettings();
  };
}
seen("motion").onclick = () => { settings.motion = settings.motion ? "" : "yes"; showSettings(); };

// The last take

const takeKey = () => `take/${take.name}/${kind}`;

// A phone's deck shows the contact sheet in small; other pictures are fetched while the take is open.
function openPicture() {
  for (const button of seen("kinds").children) {
    button.setAttribute("role", "radio");
    button.setAttribute("aria-checked", String(button.dataset.kind === kind));
  }
  if (!take) return;
  if (shownTake !== takeKey()) { seen("picture").hidden = true; showAbsent(take.has_pictures ? reasons.get(takeKey()) || {words: "One moment …"} : {words: ""}); }
  link.say("open", {picture: take.has_pictures ? takeKey() : ""});
}

function showAbsent({words, can_compute: canCompute}) {
  seen("absent").textContent = words;
  seen("compute").hidden = !canCompute;
}

function drawTake(key, bytes) {
  link.say("seen", {picture: key});
  if (!take || key !== takeKey()) return;
  const picture = seen("picture"), old = picture.src;
  shownTake = key;
  picture.src = URL.createObjectURL(new Blob([bytes]));
  picture.className = kind;
  picture.alt = `${kind} of ${take.name}`;
  picture.hidden = false;
  showAbsent({words: kind === "depth" ? "Bright is near, blue is far; dark: no distance." : ""});
  if (kind === "sheet") {
    seen("thumbnail").src = picture.src;
    seen("thumbnail").hidden = false;
  } else if (old && old !== seen("thumbnail").src) URL.revokeObjectURL(old);
}

seen("kinds").onclick = event => { if (event.target.dataset.kind) { kind = event.target.dataset.kind; openPicture(); } };
// The first tap opens the take on a wide screen, where a small picture is shown beside the cameras; the next enlarges it.
seen("picture").onclick = event => {
  if (document.body.classList.contains("taken")) seen("frame").classList.toggle("whole");
  else document.body.classList.add("taken");
};
seen("last").onclick = () => document.body.classList.toggle("taken");
seen("close").onclick = () => document.body.classList.remove("taken");
seen("compute").onclick = () => link.say("depth");

// The screen stays on while the page is in front.
async function keepAwake() {
  try { if (!document.hidden) await navigator.wakeLock.request("screen"); } catch { /* not every browser can */ }
}
document.addEventListener("visibilitychange", keepAwake);
document.addEventListener("click", keepAwake, {once: true});
showSettings();
showCourse();
link.join();
