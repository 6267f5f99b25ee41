// Sound worklet: passes the microphone's samples to the link worker, 40 ms at a time. It has no clock of its own.
"use strict";
const SAMPLES = 1920;

class Sound extends AudioWorkletProcessor {
  constructor() {
    super();
    this.made = new Int16Array(SAMPLES);
    this.count = 0;
    this.port.onmessage = event => { this.link = event.data; };
  }

  process([[channel]]) {
    for (const value of channel || []) {
      this.made[this.count++] = Math.max(-1, Math.min(1, value)) * 32767;
      if (this.count < SAMPLES) continue;
      if (this.link) this.link.postMessage(this.made.buffer, [this.made.buffer]);
      this.made = new Int16Array(SAMPLES);
      this.count = 0;
    }
    return true;
  }
}

registerProcessor("sound", Sound);
