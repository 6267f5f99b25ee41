// Counts a screen's refreshes by the timestamps of animation frames, ms.
//
// Callbacks come once a refresh, early or late by what the browser's clock hides, and not at all where the
// page was too slow. So the number is that of a line through all timestamps so far, not of the callbacks: after a
// refresh without a callback it goes on by two, and is right again. Until the line is known, and whenever
// callbacks stop following it, there is no number.
class RefreshCounter {
  // How long the period is measured before the first number, and by how many callbacks at least.
  static MEASURE_MS = 2000;
  static MEASURE_CALLBACKS = 40;
  // Faster than any screen: a browser that calls back without waiting for one.
  static MIN_PERIOD_MS = 1.5;
  static MAX_PERIOD_MS = 60;
  // Of a period: what a callback may be off the line, and what it may be drawn late by and still make its refresh.
  static MAX_OFF = 0.35;
  static MAX_LATE = 0.8;
  // Of the last callbacks that were judged, so many off the line make it a wrong line.
  static JUDGED = 60;
  static MAX_STRAYS = 8;

  constructor() {
    this.number = null;
    this.period = null;
    this.missed = 0;
    this.problem = "";
    this.last = -1;
    this.begin();
  }

  // Forget the line; numbers go on from the last one.
  begin() {
    this.number = null;
    this.times = [];
    this.strays = [];
  }

  // Take the timestamp of a callback and the time when it ran. Returns the number to draw, or null for none.
  take(timestamp, ran) {
    if (this.times !== null) this.measure(timestamp);
    else this.follow(timestamp, ran);
    return this.number;
  }

  measure(timestamp) {
    const times = this.times;
    if (times.length && timestamp <= times[times.length - 1]) return;
    times.push(timestamp);
    const span = timestamp - times[0];
    if (span < RefreshCounter.MEASURE_MS || times.length < RefreshCounter.MEASURE_CALLBACKS) {
      if (span > 3 * RefreshCounter.MEASURE_MS) this.fail("the page is hardly drawn");
      return;
    }
    const gaps = times.slice(1).map((t, i) => t - times[i]).sort((a, b) => a - b);
    const usual = gaps[gaps.length >> 1];
    // Callbacks are numbered one by one, so that the usual gap's error does not add up.
    let at = 0;
    const numbers = [0];
    for (let i = 1; i < times.length; i++) {
      at += Math.max(1, Math.round((times[i] - times[i - 1]) / usual));
      numbers.push(at);
    }
    const mean = (list) => list.reduce((sum, one) => sum + one, 0) / list.length;
    const [n, t] = [mean(numbers), mean(times)];
    const slope =
      numbers.reduce((sum, k, i) => sum + (k - n) * (times[i] - t), 0) /
      numbers.reduce((sum, k) => sum + (k - n) ** 2, 0);
    const off = numbers.filter((k, i) => Math.abs(times[i] - t - (k - n) * slope) > RefreshCounter.MAX_OFF * slope);
    if (!(slope >= RefreshCounter.MIN_PERIOD_MS && slope <= RefreshCounter.MAX_PERIOD_MS)) {
      this.fail("the browser does not wait for the screen");
    } else if (off.length > 0.05 * times.length || at > 1.15 * times.length) {
      this.fail("the refreshes are uneven");
    } else {
      this.problem = "";
      this.period = slope;
      // The line: refresh `zero` + k is at `origin` + k * period.
      this.origin = t + (at - n) * slope;
      this.last += 1;
      this.zero = this.number = this.last;
      this.times = null;
    }
  }

  follow(timestamp, ran) {
    const steps = Math.round((timestamp - this.origin) / this.period);
    const off = (timestamp - this.origin) / this.period - steps;
    this.judge(Math.abs(off) > RefreshCounter.MAX_OFF || steps > 1000);
    if (this.times !== null) return;
    const late = ran - timestamp > RefreshCounter.MAX_LATE * this.period;
    const number = this.zero + steps;
    if (number > this.last) {
      this.missed += number - this.last - 1 + (late ? 1 : 0);
      this.last = this.number = number;
      this.zero = number;
      // A slow loop: the line gives in to a twentieth of what a callback is off, the period to far less.
      this.origin += (steps + 0.05 * off) * this.period;
      this.period += 0.0006 * off * this.period;
    }
  }

  judge(stray) {
    this.strays.push(stray);
    if (this.strays.length > RefreshCounter.JUDGED) this.strays.shift();
    if (this.strays.filter(Boolean).length > RefreshCounter.MAX_STRAYS) this.fail("the refreshes changed their pace");
  }

  fail(why) {
    this.problem = why;
    this.begin();
  }
}
