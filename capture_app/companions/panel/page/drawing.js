// Placement of a panel on the screen, and drawing of its lit lamps.
//
// The reader assumes that a screen draws from one edge of the panel to the other in a known fraction of a refresh.
// The panel therefore spans that fraction of the screen along the scan direction, rotated or stretched if needed.
// The reader fits a flat panel from an unknown viewpoint, so stretching does not disturb it.
class Drawing {
  // Fraction of a refresh in which a screen draws all its lines; the rest is blanking (1080 of 1125 lines at 1080p60).
  static ACTIVE = 0.96;
  static BAR = 24;
  // Scan direction in the panel's coordinates, by that of the screen, for a panel rotated by a quarter turn.
  static TURNED = { down: "right", right: "up", up: "left", left: "down" };

  // `layout`: description shared by all screen panels; `screens`: their names, rates, directions and markers.
  constructor(canvas, layout, screens, scanShare) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false });
    this.layout = layout;
    this.screens = screens;
    this.scanShare = scanShare;
    this.panel = null;
    this.lit = [];
    this.tick = null;
    this.turn = null;
    this.share = 0;
    // Number that tells this page from others, and from itself before it was loaded again.
    this.page = Math.floor(Math.random() * 2 ** layout.page_bits);
  }

  // Choose and place the panel for a rate in Hz and a scan direction in the screen's coordinates.
  place(rate, way, size) {
    const along = way === "down" || way === "up" ? "height" : "width";
    const other = along === "height" ? "width" : "height";
    const room = { width: size.width, height: size.height - Drawing.BAR };
    const wanted = (size[`screen_${along}`] * this.scanShare) / Drawing.ACTIVE;
    const extent = Math.min(wanted, room[along]);
    const fit = (turned) => {
      const panel = turned
        ? { width: this.layout.height, height: this.layout.width }
        : { width: this.layout.width, height: this.layout.height };
      const step = { [along]: extent / panel[along] };
      step[other] = Math.min(step[along], room[other] / panel[other]);
      return { turned, step, panel, least: Math.min(step.width, step.height) };
    };
    const [straight, turned] = [fit(false), fit(true)];
    const best = turned.least > 1.05 * straight.least ? turned : straight;
    const scan = best.turned ? Drawing.TURNED[way] : way;
    this.turned = best.turned;
    this.step = best.step;
    this.left = (size.width - best.panel.width * best.step.width) / 2;
    this.top = Drawing.BAR + (room.height - best.panel.height * best.step.height) / 2;
    this.density = size.density;
    this.share = (extent / size[`screen_${along}`]) * Drawing.ACTIVE;
    this.panel = this.screens.find(
      (one) => one.scan === scan && Math.abs(rate / one.rate_hz - 1) <= this.layout.rate_tolerance
    );
    this.canvas.width = Math.round(size.width * size.density);
    this.canvas.height = Math.round(size.height * size.density);
    this.clear();
  }

  // Fill a rectangle of the panel, given in pitches; its edges are rounded to the screen's pixels.
  fill(colour, x, y, width, height) {
    if (this.turned) [x, y, width, height] = [this.layout.height - y - height, x, height, width];
    const [left, right] = [x, x + width].map((at) => Math.round((this.left + at * this.step.width) * this.density));
    const [top, bottom] = [y, y + height].map((at) => Math.round((this.top + at * this.step.height) * this.density));
    this.context.fillStyle = colour;
    this.context.fillRect(left, top, right - left, bottom - top);
  }

  clear() {
    this.context.fillStyle = "#fff";
    this.context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    this.tick = null;
  }

  // Draw a refresh's number; null clears the panel, so that no image of it can be read.
  show(number) {
    if (number === null || !this.panel) {
      if (this.tick !== null) this.clear();
      return;
    }
    if (this.tick === null) this.begin();
    const tick = number % this.layout.cycle_ticks;
    const turn = Math.floor(number / this.layout.cycle_ticks);
    this.tick = tick;
    if (turn !== this.turn) this.showTurn(turn);
    const reach = this.layout.lamp_size / 2;
    this.layout.lamps.forEach((lamp, number) => {
      const lit = (((tick - lamp.start) % lamp.period) + lamp.period) % lamp.period < lamp.lit;
      if (lit === this.lit[number]) return;
      this.lit[number] = lit;
      this.fill(lit ? "#fff" : "#000", lamp.x - reach, lamp.y - reach, 2 * reach, 2 * reach);
    });
  }

  // Draw the code of a turn: its number, this page's, and a checksum (CRC-6-ITU), highest bit first.
  showTurn(turn) {
    this.turn = turn;
    const { turn_bits, page_bits, check_bits, check_polynomial, cells } = this.layout;
    const value = (turn % 2 ** turn_bits) * 2 ** page_bits + this.page;
    const full = 2 ** check_bits - 1;
    let check = full;
    for (let bit = turn_bits + page_bits - 1; bit >= 0; bit--) {
      const top = (check >> (check_bits - 1)) ^ ((value >> bit) & 1);
      check = ((check << 1) ^ (top ? check_polynomial : 0)) & full;
    }
    const coded = value * 2 ** check_bits + check;
    cells.forEach(([x, y], number) => {
      const black = (coded >> (cells.length - 1 - number)) & 1;
      this.fill(black ? "#000" : "#fff", x, y, 1, 1);
    });
  }

  begin() {
    this.turn = null;
    for (const ground of this.layout.dark) this.fill("#000", ...ground);
    this.lit = this.layout.lamps.map(() => false);
    this.layout.markers.forEach((marker, number) => {
      const white = this.panel.markers[number];
      const side = Math.sqrt(white.length);
      const square = this.layout.marker_size / side;
      this.fill("#000", marker.x, marker.y, this.layout.marker_size, this.layout.marker_size);
      for (let at = 0; at < white.length; at++) {
        if (white[at] === "1") {
          this.fill("#fff", marker.x + (at % side) * square, marker.y + Math.floor(at / side) * square, square, square);
        }
      }
    });
  }
}
