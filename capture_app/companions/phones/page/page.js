// User interface of the phone's page; it opens the camera, and workers read and send its frames.
"use strict";
const RETRY_MS = 2000, CONTROLS_MS = 1000, REPLACED = 4001;
const BLINKS = 8, LIT_MS = 200, DARK_MS = 350, UNEVEN_MS = 200, SPIN_MS = 4;
const seen = id => document.getElementById(id);
const sleep = ms => new Promise(done => setTimeout(done, ms));
const link = new Worker("link.js");
const pipe = new MessageChannel();
link.postMessage({camera: pipe.port1}, [pipe.port1]);
camera.postMessage({link: pipe.port2}, [pipe.port2]);
const page = random();
let running = false, joining = false, linked = false, wake = null, sent = 0, restarting = false, told = "";
let model = "", controlsTold = "";

function random() {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), one => one.toString(16).padStart(2, "0")).join("");
}

// A private window may store nothing; the phone then counts as a new one each time.
const memory = {
  get(name) { try { return localStorage.getItem("simulshot-" + name) || ""; } catch { return ""; } },
  set(name, value) { try { localStorage.setItem("simulshot-" + name, value); } catch { /* see above */ } },
};
const key = memory.get("key") || random();
memory.set("key", key);

function show(mood, state, words = "") {
  document.body.className = mood + (stream ? " seeing" : "");
  seen("state").textContent = state;
  seen("words").textContent = words;
}

function offer(words, button = "Start the camera", mood = "wait", state = "Not started") {
  running = false;
  seen("start").hidden = false;
  seen("tools").hidden = seen("figures").hidden = true;
  seen("go").textContent = button;
  seen("go").disabled = false;
  show(mood, state, words);
}

async function start() {
  running = true;
  seen("go").disabled = true;
  memory.set("name", seen("wish").value);
  show("wait", "Starting", "The browser asks whether this page may use the camera: allow it.");
  try {
    await openAndTry();
    await openSound();
  } catch (error) {
    closeCamera();
    stream = null;
    offer(REFUSALS[error.name] || `The camera cannot be opened (${error.name}: ${error.message}).`, "Try again", "bad", "No camera");
    return;
  }
  seen("start").hidden = true;
  seen("tools").hidden = seen("figures").hidden = false;
  keepAwake();
  join();
}

function stop(words) {
  memory.set("joined", "");
  closeCamera();
  closeSound();
  stream = null;
  linked = false;
  link.postMessage({close: true});
  if (wake) wake.release().catch(() => { /* it is gone already */ });
  offer(words);
}

async function loseCamera() {
  say({type: "page-hidden", why: "its camera was taken by something else"});
  while (running && !document.hidden) {
    show("bad", "Camera lost", "Something else took the camera, or it failed. It is tried again; close other camera apps.");
    closeCamera();
    await sleep(RETRY_MS);
    try {
      await openCamera(false);
      tellOpened();
      return;
    } catch { /* tried again */ }
  }
}

// The leader

async function join() {
  if (joining || linked) return;
  joining = true;
  for (let first = true; running && !linked; first = false) {
    if (!first) await sleep(RETRY_MS);
    if (!running) break;
    let answer, body = {};
    try {
      answer = await fetch("join", {
        method: "POST", headers: {"Content-Type": "application/json"}, cache: "no-store",
        body: JSON.stringify({secret: location.hash.slice(1), key, name: seen("wish").value}),
      });
      body = await answer.json();
    } catch {
      show("bad", "No leader", "The leader does not answer. Is this phone still in the same WiFi? It is tried again.");
      continue;
    }
    if (answer.status === 403) {
      stop(body.words);
      show("bad", "Not let in", body.words);
      break;
    }
    if (!answer.ok) {
      show("bad", "No leader", body.words || "The leader cannot take this phone now. It is tried again.");
      continue;
    }
    memory.set("joined", "yes");
    // The secret has been used, so it is removed from the address.
    history.replaceState(null, "", location.pathname + location.search);
    seen("name").textContent = body.name;
    document.title = body.name;
    const hello = {type: "hello", page, user_agent: navigator.userAgent, model};
    linked = true;
    link.postMessage({open: (location.protocol === "https:" ? "wss://" : "ws://") + location.host + "/link/" + body.ticket, hello});
    show("wait", "Connecting", "");
  }
  joining = false;
}

camera.addEventListener("message", event => {
  if (event.data.type !== "turned" || !settings) return;
  settings = {...settings, width: event.data.width, height: event.data.height};
  seen("size").textContent = `${settings.width}×${settings.height}`;
  tellOpened();
});

function say(message) { link.postMessage({say: message}); }

function tellOpened() {
  if (!stream) return;
  say({type: "opened", ...settings});
  controlsTold = "";
  tellControls();
}

// Send the controls when they change: automatic values follow the light.
function tellControls(answer = null) {
  const controls = controlStates(stream && stream.getVideoTracks()[0]), now = JSON.stringify(controls);
  if (!linked || (!answer && now === controlsTold)) return;
  controlsTold = now;
  say({type: "controls", controls, ...answer});
}

async function obeyControl({number: asked, control, value}) {
  let problem = "";
  try {
    await setControl(stream.getVideoTracks()[0], control, value);
  } catch (error) {
    problem = `the browser refuses it (${error.name})`;
  }
  tellControls({answers: asked, problem});
}

async function restart(at_ms) {
  if (!stream || document.hidden) return;
  restarting = true;
  const period_ms = 1000 / (settings.frame_rate || 30);
  closeCamera();
  let left_ms = at_ms - performance.timeOrigin - performance.now();
  if (left_ms < 0) left_ms += Math.ceil(-left_ms / period_ms) * period_ms;
  const begin_ms = performance.now() + left_ms;
  // Timers are some ms late, so the last part is a busy wait.
  if (left_ms > SPIN_MS) await sleep(left_ms - SPIN_MS);
  while (performance.now() < begin_ms);
  try {
    await openCamera(false);
    restarting = false;
  } catch {
    restarting = false;
    loseCamera();
  }
}

const STATES = {
  joining: ["wait", "Joining", "Connecting to the leader."],
  syncing: ["wait", "Measuring the clock", "Leave the phone where it is. This takes some seconds."],
  aligning: ["wait", "Getting in step", "The camera restarts until its frames begin when the others' do; its picture may stop for a moment."],
  degraded: ["good", "Ready, roughly", "Pictures are taken by the leader."],
  ready: ["good", "Ready", "Pictures are taken by the leader. Do not move the phone, and leave this page open."],
  failed: ["bad", "Paused", ""],
  lost: ["bad", "Lost", ""],
};

link.onmessage = event => {
  const message = event.data;
  if (message.type === "link") {
    linked = message.open;
    if (message.open) tellOpened();
    else if (message.code === REPLACED) stop(message.reason);
    else if (running) {
      if (message.reason) show("bad", "Disconnected", message.reason);
      join();
    }
  } else if (message.type === "state") {
    const [mood, state, words] = STATES[message.state] || STATES.joining;
    if (message.name) seen("name").textContent = message.name;
    if (running && linked) show(mood, state, message.words || words);
    if (message.clock) seen("clock").textContent = message.clock;
    if (told && !wake) seen("words").textContent += ` ${told}`;
    seen("words").textContent += silence;
  } else if (message.type === "restart") restart(message.at_ms);
  else if (message.type === "control") obeyControl(message);
  else if (message.type === "sent") {
    sent++;
    seen("sent").textContent = `${sent} ${sent === 1 ? "picture" : "pictures"}`;
  }
};

// The screen, and hiding of the page

async function keepAwake() {
  try {
    wake = await navigator.wakeLock.request("screen");
    wake.onrelease = () => { wake = null; };
  } catch {
    wake = null;
    told = "This browser cannot keep the screen on: set the phone's own screen time-out to its longest.";
  }
}

document.addEventListener("visibilitychange", async () => {
  if (!running) return;
  if (document.hidden) {
    say({type: "page-hidden", why: "its page is in the background, or its screen is locked"});
    return;
  }
  keepAwake();
  show("wait", "Back", "This page was in the background, and its camera stood still. It goes on now.");
  const track = stream && stream.getVideoTracks()[0];
  if (track && track.readyState === "live" && !track.muted) {
    if (linked) tellOpened();
    else join();
    return;
  }
  await loseCamera();
});

// Blinking light, by which the times of all cameras are compared

async function blink() {
  const track = stream && stream.getVideoTracks()[0];
  const torch = track && track.getCapabilities && track.getCapabilities().torch;
  const flash = seen("flash");
  seen("blink").disabled = true;
  flash.hidden = Boolean(torch);
  const light = async lit => {
    if (torch) await track.applyConstraints({advanced: [{torch: lit}]});
    else flash.classList.toggle("lit", lit);
  };
  try {
    await sleep(1000);
    for (let n = 0; n < BLINKS; n++) {
      await light(true);
      await sleep(LIT_MS);
      await light(false);
      // Uneven, so that blinks occur at any phase of the frames.
      await sleep(DARK_MS + UNEVEN_MS * Math.random());
    }
  } catch (error) {
    seen("words").textContent = `The light cannot be switched (${error.name}).`;
  }
  flash.hidden = true;
  seen("blink").disabled = false;
}

seen("start").onsubmit = event => {
  event.preventDefault();
  start();
};
seen("stop").onclick = () => stop("This phone has left. Start the camera to come back.");
seen("blink").onclick = blink;

async function suggestName() {
  try { model = (await navigator.userAgentData.getHighEntropyValues(["model"])).model; } catch { /* not every browser tells */ }
  const kind = /iPhone|iPad/.exec(navigator.userAgent);
  return memory.get("name") || model || (kind ? kind[0] : "phone");
}

async function begin() {
  seen("wish").value = await suggestName();
  if (!self.crossOriginIsolated) told = "This browser's clock is coarse: times will be less sure.";
  offer("This phone becomes a camera of the rig. Put it where it shall stand, plug it in, and start.");
  let allowed = false;
  try { allowed = (await navigator.permissions.query({name: "camera"})).state === "granted"; } catch { /* asked at the start */ }
  // Restart automatically if the phone had discarded the page from memory.
  if (memory.get("joined") && allowed && !document.hidden) start();
}

setInterval(() => { if (running && stream && !restarting) tellControls(); }, CONTROLS_MS);
begin();
