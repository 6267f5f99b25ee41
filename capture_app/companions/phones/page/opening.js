// The phone's camera: opened, tested, read through the API that the browser has, and closed.
"use strict";
const WANTED = document.documentElement.dataset.size.split("x").map(Number), SLOW_SHARE = 0.1, SOUND_HZ = 48000;
// A phone that is too slow for the requested image size uses half of it.
const SIZES = [WANTED, WANTED.map(side => Math.round(side / 2))];
const camera = new Worker("camera.js");
let stream = null, number = 0, device = null, size = 0, settings = null, audio = null, microphone = null;
let silence = "", copies = 0;
// Copies of frames that the worker has not taken yet.
const COPIES = 3;
camera.addEventListener("message", event => { if (event.data.type === "taken") copies--; });

function constraints() {
  const [width, height] = SIZES[size];
  const wanted = {width: {ideal: width}, height: {ideal: height}, frameRate: {ideal: 30}};
  return {audio: false, video: {...wanted, ...(device ? {deviceId: {exact: device}} : {facingMode: "environment"})}};
}

async function openCamera(trial) {
  const opened = await navigator.mediaDevices.getUserMedia(constraints());
  if (!running) {
    opened.getTracks().forEach(track => track.stop());
    throw new DOMException("it was stopped", "AbortError");
  }
  stream = opened;
  const track = stream.getVideoTracks()[0], own = ++number;
  device = track.getSettings().deviceId || null;
  track.onended = () => { if (own === number && running && !restarting) loseCamera(); };
  seen("video").srcObject = stream;
  document.body.classList.add("seeing");
  if (typeof MediaStreamTrackProcessor === "undefined") {
    camera.postMessage({begin: own, trial});
    readVideo(own);
  } else {
    const readable = new MediaStreamTrackProcessor({track, maxBufferSize: 4}).readable;
    camera.postMessage({begin: own, trial, readable}, [readable]);
  }
  await applyHeld(track).catch(() => { /* it is told by its controls */ });
  return track;
}

// For browsers without an API for reading frames: copy each frame when it is shown. A worker that is slower than the
// camera gets fewer of them, as its queue would make each later than the one before.
function readVideo(own) {
  const video = seen("video");
  let missed = 0;
  const look = (shown_ms, frame) => {
    if (own !== number) return;
    video.requestVideoFrameCallback(look);
    const arrived_us = performance.now() * 1000, captured = frame.captureTime;
    // WebKit's media time counts the frames that it shows: a camera that loses some falls ever further behind.
    const media_us = captured ? captured * 1000 : frame.mediaTime > 0 ? frame.mediaTime * 1e6 : shown_ms * 1000;
    const times = {media_us, arrived_us, capture_us: captured ? captured * 1000 : null, origin_ms: performance.timeOrigin};
    if (copies >= COPIES) {
      missed++;
      return;
    }
    copies++;
    createImageBitmap(video).then(bitmap => {
      camera.postMessage({bitmap, stream: own, times, missed}, [bitmap]);
      missed = 0;
    }, () => { copies--; /* between two streams */ });
  };
  video.requestVideoFrameCallback(look);
}

function closeCamera() {
  number++;
  camera.postMessage({end: true});
  if (stream) stream.getTracks().forEach(track => track.stop());
}

// The microphone is opened once: restarts of the camera leave it alone. A phone without one has a silent camera.
async function openSound() {
  if (!document.documentElement.dataset.sound || audio) return;
  silence = "";
  try {
    audio = new AudioContext({sampleRate: SOUND_HZ});
    const plain = {echoCancellation: false, noiseSuppression: false, autoGainControl: false};
    const [opened] = await Promise.all([
      navigator.mediaDevices.getUserMedia({audio: plain}), audio.audioWorklet.addModule("sound.js"), audio.resume()]);
    const sound = new AudioWorkletNode(audio, "sound", {numberOfOutputs: 0}), pipe = new MessageChannel();
    link.postMessage({sound: pipe.port1}, [pipe.port1]);
    sound.port.postMessage(pipe.port2, [pipe.port2]);
    audio.createMediaStreamSource(opened).connect(sound);
    microphone = opened;
  } catch (error) {
    closeSound();
    silence = ` There is no sound: the browser does not give the microphone (${error.name}).`;
  }
}

function closeSound() {
  if (microphone) microphone.getTracks().forEach(track => track.stop());
  if (audio) audio.close().catch(() => { /* it is closed already */ });
  microphone = audio = null;
}

function tryOut() {
  return new Promise((done, fail) => {
    const over = setTimeout(() => fail(new DOMException("no picture came in 15 s", "TimeoutError")), 15000);
    camera.onmessage = event => {
      if (event.data.type !== "trial") return;
      clearTimeout(over);
      done(event.data);
    };
  });
}

const REFUSALS = {
  NotAllowedError: "The camera was refused. Tap the sign before the address, then Permissions, Camera, Allow; or look in " +
    "the phone's settings whether this browser may use the camera. Then try again.",
  NotFoundError: "No camera was found on this device.",
  NotReadableError: "The camera is in use: close the other app that has it, then try again.",
  OverconstrainedError: "The camera cannot do what was asked of it.",
  TimeoutError: "The camera was opened, but gave no picture. Close other apps that use it, then try again.",
};

async function openAndTry() {
  for (;;) {
    const trial = tryOut();
    trial.catch(() => { /* told below */ });
    const track = await openCamera(true);
    const {width, height, frames, skipped} = await trial;
    if (skipped > SLOW_SHARE * frames && size + 1 < SIZES.length) {
      size++;
      closeCamera();
      show("wait", "Starting", "This phone is too slow for large pictures: smaller ones are tried.");
      continue;
    }
    settings = {width, height, frame_rate: track.getSettings().frameRate || 0, label: track.label};
    seen("size").textContent = `${width}×${height}`;
    const can = track.getCapabilities ? track.getCapabilities() : {};
    seen("blink").textContent = can.torch ? "Blink the light 8 times" : "Blink the screen 8 times";
    return;
  }
}
