// Frame worker: sends the frames' times, and stores the images as JPEGs until they are requested.
"use strict";
const QUALITY = 0.9, PREVIEW_QUALITY = 0.6, WAITING = 6;
const TRIAL_MS = 10000, KEPT_MS = 5000, KEPT_WHILE_ASKED_MS = 30000, ASKED_MS = 10000;
const KEPT_BYTES = (navigator.deviceMemory || 4) <= 2 ? 64e6 : 160e6;
let link = null, stream = 0, next = 0, waiting = 0, bytes = 0, askedMs = -Infinity, trial = null, canvas = null, sized = null;
const ring = new Map();
const now_us = () => performance.now() * 1000;

// Read the stream's frames as they arrive, through the browser's own reader.
async function read(readable, own) {
  const reader = readable.getReader();
  for (;;) {
    const {value: frame, done} = await reader.read();
    const arrived_us = now_us();
    if (done) return;
    if (own !== stream) {
      frame.close();
      reader.cancel();
      return;
    }
    let told = null;
    try {
      told = frame.metadata ? frame.metadata().captureTime : null;
    } catch { told = null; }
    take(frame, frame.displayWidth, frame.displayHeight, {
      media_us: frame.timestamp, arrived_us, capture_us: told ? told * 1000 : null, origin_ms: performance.timeOrigin,
    });
    frame.close();
  }
}

function take(image, width, height, times) {
  // Rotating the phone changes the images' size.
  if (sized && !trial && (sized[0] !== width || sized[1] !== height)) postMessage({type: "turned", width, height});
  sized = [width, height];
  if (trial) trial.frames++;
  if (waiting >= WAITING) {
    // Count it as a dropped frame, so that no image is announced that is never encoded.
    if (trial) trial.skipped++;
    judge();
    return;
  }
  const id = next++, own = stream;
  if (!canvas || canvas.width !== width || canvas.height !== height) canvas = new OffscreenCanvas(width, height);
  canvas.getContext("2d", {alpha: false}).drawImage(image, 0, 0);
  waiting++;
  const entry = {at_ms: performance.now(), size: 0, jpeg: null, width, height};
  entry.jpeg = canvas.convertToBlob({type: "image/jpeg", quality: QUALITY}).then(
    blob => {
      if (ring.get(id) === entry) bytes += entry.size = blob.size;
      return blob;
    }, () => null).finally(() => { waiting--; });
  ring.set(id, entry);
  thin();
  judge();
  if (link && !trial) link.postMessage({type: "frame", id, stream: own, ...times});
}

// Report whether this phone keeps up with images of this size, before the stream is used: after 30 frames, or with those
// that came in TRIAL_MS, as some cameras begin slowly.
function judge() {
  if (trial && trial.frames >= 30) endTrial(trial);
}

function endTrial(own) {
  if (trial !== own || !own.frames) return;
  postMessage({type: "trial", width: sized[0], height: sized[1], ...own});
  trial = null;
}

function thin() {
  const kept_ms = performance.now() - askedMs < ASKED_MS ? KEPT_WHILE_ASKED_MS : KEPT_MS;
  for (const [id, entry] of ring) {
    if (performance.now() - entry.at_ms < kept_ms && bytes < KEPT_BYTES) return;
    ring.delete(id);
    bytes -= entry.size;
  }
}

async function answer(message) {
  const entry = ring.get(message.id);
  let blob = entry ? await entry.jpeg : null;
  if (message.type === "picture") askedMs = performance.now();
  else if (blob && message.width < entry.width) {
    const height = Math.max(1, Math.round(entry.height * message.width / entry.width));
    const small = await createImageBitmap(blob, {resizeWidth: message.width, resizeHeight: height});
    const drawn = new OffscreenCanvas(message.width, height);
    drawn.getContext("2d", {alpha: false}).drawImage(small, 0, 0);
    small.close();
    blob = await drawn.convertToBlob({type: "image/jpeg", quality: PREVIEW_QUALITY});
  }
  const data = blob ? await blob.arrayBuffer() : new ArrayBuffer(0);
  link.postMessage({type: message.type, id: message.id, bytes: data}, [data]);
}

onmessage = event => {
  const message = event.data;
  if (message.link) {
    link = message.link;
    link.onmessage = asked => answer(asked.data).catch(() => {
      link.postMessage({type: asked.data.type, id: asked.data.id, bytes: new ArrayBuffer(0)});
    });
  } else if (message.begin) {
    stream = message.begin;
    trial = message.trial ? {frames: 0, skipped: 0} : null;
    if (trial) setTimeout(endTrial, TRIAL_MS, trial);
    if (message.readable) read(message.readable, stream);
  } else if (message.end) stream = 0;
  else if (message.bitmap) {
    if (trial) {
      trial.frames += message.missed;
      trial.skipped += message.missed;
    }
    if (message.stream === stream) take(message.bitmap, message.bitmap.width, message.bitmap.height, message.times);
    message.bitmap.close();
    postMessage({type: "taken"});
  }
};
