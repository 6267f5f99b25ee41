// Counter of a screen's refreshes, from the timestamps (ms) of animation frames.
//
// The browser calls back once per refresh, with limited clock resolution, and skips refreshes for which the page
// was too slow. The number therefore comes from a line fitted through all timestamps so far, not from counting
// callbacks: after a skipped refresh it advances by two and stays correct. There is no number before the line is
// fitted, or after callbacks stop following it.
class RefreshCounter {
  // Minimum duration and number of callbacks of the first fit.
  static MEASURE_MS = 2000;
  static MEASURE_CALLBACKS = 40;
  // A shorter period is faster than any screen: the browser does not wait for refreshes.
  static MIN_PERIOD_MS = 1.5;
  static MAX_PERIOD_MS = 60;
  // In periods: max residual of a callback, and max delay at which its drawing still makes the refresh.
  static MAX_OFF = 0.35;
  static MAX_LATE = 0.8;
  // Number of recent callbacks judged, and max outliers among them before the line is rejected.
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

  // Restart the fit; numbers continue from the last one.
  begin() {
    this.number = null;
    this.times = [];
    this.strays = [];
  }

  // Add a callback's timestamp and the time at which it ran. Returns the number to draw, or null.
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
    // Callbacks are numbered gap by gap, so that the error of the median gap does not add up.
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
      // Line: refresh `zero` + k is at `origin` + k * period.
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
      // Slow control loop: the line follows a twentieth of a callback's residual, the period far less.
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
