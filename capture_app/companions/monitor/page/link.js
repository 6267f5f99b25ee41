// Link to the monitor's server: admission by the code in the address, then messages and pictures.
"use strict";
const RETRY_MS = 2000, BAD_PAGE = 1003;

function random() {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), one => one.toString(16).padStart(2, "0")).join("");
}

// A private window may store nothing; it then needs a new code after each load.
const memory = {
  get(name) { try { return localStorage.getItem("simulshot-monitor-" + name) || ""; } catch { return ""; } },
  set(name, value) { try { localStorage.setItem("simulshot-monitor-" + name, value); } catch { /* see above */ } },
};
const key = memory.get("key") || random();
memory.set("key", key);

// Calls onMessage(object), onPicture(key, bytes) and onLost(words, isRefused).
class Link {
  constructor(handlers) { this.handlers = handlers; this.socket = null; this.heard = 0; }

  say(type, fields = {}) {
    if (this.socket && this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({type, ...fields}));
  }

  async join() {
    let answer, body = {};
    try {
      answer = await fetch("join", {
        method: "POST", headers: {"Content-Type": "application/json"}, cache: "no-store",
        body: JSON.stringify({secret: location.hash.slice(1), key, name: ""}),
      });
      body = await answer.json();
    } catch {
      this.retry("The monitor's server does not answer. Is this device still in the same WiFi?");
      return;
    }
    if (answer.status === 403) { this.handlers.onLost(body.words, true); return; }
    if (!answer.ok) { this.retry(body.words || "The server cannot take this monitor now."); return; }
    // The secret has been used, so it is removed from the address.
    history.replaceState(null, "", location.pathname + location.search);
    this.open(body.ticket);
  }

  open(ticket) {
    const socket = new WebSocket((location.protocol === "https:" ? "wss://" : "ws://") + location.host + "/link/" + ticket);
    socket.binaryType = "arraybuffer";
    socket.onmessage = event => {
      this.heard = performance.now();
      if (typeof event.data === "string") { this.handlers.onMessage(JSON.parse(event.data)); return; }
      const bytes = new Uint8Array(event.data), end = 1 + bytes[0];
      this.handlers.onPicture(new TextDecoder().decode(bytes.subarray(1, end)), bytes.subarray(end));
    };
    socket.onclose = event => {
      this.socket = null;
      if (event.code === BAD_PAGE) this.handlers.onLost(event.reason, true);
      else this.retry(event.reason || "The connection to the monitor's server was lost.");
    };
    socket.onopen = () => { this.heard = performance.now(); this.handlers.onOpen(); };
    this.socket = socket;
  }

  retry(words) {
    this.handlers.onLost(words, false);
    setTimeout(() => this.join(), RETRY_MS);
  }
}
