// Link to the leader, in its own worker so that encoding images never delays clock messages.
"use strict";
const PING = 1, FRAME = 2, PICTURE = 3, PREVIEW = 4, SOUND = 5;
const QUICK = 400, QUICK_MS = 4, SLOW_MS = 40, BUSY_BYTES = 20000, SLOWEST_MS = 500;
let socket = null, camera = null, count = 0, last = null, timer = 0;
// All threads' times are converted to this worker's clock.
const now_us = () => performance.now() * 1000;

function open(url, hello) {
  const own = socket = new WebSocket(url);
  own.binaryType = "arraybuffer";
  own.onopen = () => {
    count = 0;
    last = null;
    own.send(JSON.stringify({...hello, resolution_us: resolution()}));
    postMessage({type: "link", open: true});
    ping();
  };
  own.onmessage = event => receive(event.data);
  own.onclose = event => {
    if (socket !== own) return;
    clearTimeout(timer);
    socket = null;
    postMessage({type: "link", open: false, code: event.code, reason: event.reason});
  };
}

// Return the step of this browser's clock, in us: many browsers coarsen it.
function resolution() {
  let least = 1e6;
  for (let k = 0; k < 20; k++) {
    const begin = now_us();
    let end = begin;
    while (end === begin) end = now_us();
    least = Math.min(least, end - begin);
  }
  return least;
}

function ping() {
  const own = socket;
  if (!own || own.readyState !== WebSocket.OPEN) return;
  if (own.bufferedAmount < BUSY_BYTES) {
    const data = new DataView(new ArrayBuffer(25));
    data.setUint8(0, PING);
    data.setUint32(1, count, true);
    data.setUint32(5, last ? last.number : 0xffffffff, true);
    data.setFloat64(9, last ? last.received_us : 0, true);
    last = null;
    data.setFloat64(17, now_us(), true);
    own.send(data.buffer);
    count++;
  }
  timer = setTimeout(ping, count < QUICK ? QUICK_MS : SLOW_MS);
}

function receive(data) {
  const received_us = now_us();
  if (typeof data !== "string") {
    last = {number: new DataView(data).getUint32(1, true), received_us};
    return;
  }
  const message = JSON.parse(data);
  if (message.type === "picture" || message.type === "preview") camera.postMessage(message);
  else {
    // The page's clock and this worker's have different zeros.
    if (message.type === "restart") message.at_ms = performance.timeOrigin + message.at_us / 1000;
    postMessage(message);
  }
}

function send(text) {
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(text);
}

function fromCamera(message) {
  if (!socket || socket.readyState !== WebSocket.OPEN) return;
  const zero_us = (message.origin_ms - performance.timeOrigin) * 1000;
  if (message.type === "frame") {
    const data = new DataView(new ArrayBuffer(33));
    data.setUint8(0, FRAME);
    data.setUint32(1, message.id, true);
    data.setUint32(5, message.stream, true);
    data.setFloat64(9, message.media_us, true);
    data.setFloat64(17, message.arrived_us + zero_us, true);
    data.setFloat64(25, message.capture_us === null ? NaN : message.capture_us + zero_us, true);
    socket.send(data.buffer);
    return;
  }
  const picture = new Uint8Array(message.bytes), data = new Uint8Array(5 + picture.length);
  data[0] = message.type === "preview" ? PREVIEW : PICTURE;
  new DataView(data.buffer).setUint32(1, message.id, true);
  data.set(picture, 5);
  socket.send(data);
  if (message.type === "picture" && picture.length) postMessage({type: "sent", bytes: picture.length});
}

function fromMicrophone(samples) {
  const arrived_us = now_us();
  if (!socket || socket.readyState !== WebSocket.OPEN) return;
  const data = new Uint8Array(9 + samples.byteLength);
  data[0] = SOUND;
  new DataView(data.buffer).setFloat64(1, arrived_us, true);
  data.set(new Uint8Array(samples), 9);
  socket.send(data);
}

onmessage = event => {
  const message = event.data;
  if (message.sound) message.sound.onmessage = heard => fromMicrophone(heard.data);
  else if (message.camera) {
    camera = message.camera;
    camera.onmessage = answer => fromCamera(answer.data);
  } else if (message.open) open(message.open, message.hello);
  else if (message.close) {
    const own = socket;
    socket = null;
    clearTimeout(timer);
    if (own) own.close();
  } else if (message.say) send(JSON.stringify(message.say));
};
