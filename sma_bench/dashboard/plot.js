// One plot over time: lines, a limit, and the values under the pointer. Canvas, no library.

const GAP = 1.5; // s without a reading, over which no line is drawn
const DASHES = { measured: [], commanded: [2, 3], model: [7, 4] };

function niceStep(span, most) {
  const rough = span / most;
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((k) => k * power).find((step) => step >= rough);
}

function ticksBetween(low, high) {
  const step = niceStep(high - low, 4);
  const digits = Math.max(0, -Math.floor(Math.log10(step)));
  const ticks = [];
  for (let value = Math.ceil(low / step) * step; value <= high; value += step) {
    ticks.push([value, (Math.abs(value) < step / 1e3 ? 0 : value).toFixed(digits)]);
  }
  return ticks;
}

export class Plot {
  // `colour(name)` gives a CSS variable's value; `unit` is written at the axis.
  constructor(canvas, unit, colour) {
    this.canvas = canvas;
    this.unit = unit;
    this.colour = colour;
    this.pointer = null;
    this.curves = [];
    canvas.addEventListener("pointermove", (event) => {
      this.pointer = event.offsetX;
      this.draw();
    });
    canvas.addEventListener("pointerleave", () => {
      this.pointer = null;
      this.draw();
    });
  }

  // curves: {points: [[t, value]], kind, colour, label}; limit: a number or undefined.
  show(curves, now, span, limit) {
    Object.assign(this, { curves, now, span, limit });
    this.draw();
  }

  draw() {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !this.curves.length) return;
    if (this.canvas.width !== Math.round(width * ratio)) this.canvas.width = width * ratio;
    if (this.canvas.height !== Math.round(height * ratio)) this.canvas.height = height * ratio;
    const pen = this.canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = "12px system-ui, sans-serif";
    const [low, high] = this.range();
    const ticks = ticksBetween(low, high);
    const widest = Math.max(...ticks.map(([, text]) => pen.measureText(text).width));
    const box = { left: Math.max(46, widest + 9), right: width - 8, top: 8, bottom: height - 20 };
    const x = (t) => box.right + ((t - this.now) / this.span) * (box.right - box.left);
    const y = (v) => box.bottom - ((v - low) / (high - low)) * (box.bottom - box.top);
    this.axes(pen, box, x, y, ticks);
    pen.save();
    pen.beginPath();
    pen.rect(box.left, box.top - 2, box.right - box.left, box.bottom - box.top + 4);
    pen.clip();
    if (this.limit !== undefined) this.limitLine(pen, box, y(this.limit));
    for (const curve of this.curves) this.line(pen, curve, x, y);
    pen.restore();
    if (this.pointer !== null) this.readOut(pen, box, x);
  }

  range() {
    let [low, high] = [Infinity, -Infinity];
    for (const { points } of this.curves) {
      for (const [, value] of points) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    if (low > high) [low, high] = [0, 1];
    // A limit that is far off would flatten the signal; the meters show it anyway.
    if (this.limit !== undefined && high > 0.6 * this.limit) high = Math.max(high, this.limit);
    const room = Math.max(0.06 * (high - low), 1e-3 * Math.max(Math.abs(high), Math.abs(low)), 1e-3);
    return [low - room, high + room];
  }

  axes(pen, box, x, y, ticks) {
    pen.strokeStyle = this.colour("--line");
    pen.fillStyle = this.colour("--quiet");
    pen.lineWidth = 1;
    pen.textBaseline = "middle";
    pen.textAlign = "right";
    for (const [value, text] of ticks) {
      pen.beginPath();
      pen.moveTo(box.left, y(value));
      pen.lineTo(box.right, y(value));
      pen.stroke();
      pen.fillText(text, box.left - 5, y(value));
    }
    pen.textBaseline = "top";
    for (let ago = 0; ago <= this.span; ago += 15) {
      pen.textAlign = ago === 0 ? "right" : ago === this.span ? "left" : "center";
      pen.fillText(ago === 0 ? "now" : `\u2212${ago} s`, x(this.now - ago), box.bottom + 5);
    }
  }

  limitLine(pen, box, height) {
    pen.strokeStyle = this.colour("--bad");
    pen.setLineDash([8, 5]);
    pen.lineWidth = 1.5;
    pen.beginPath();
    pen.moveTo(box.left, height);
    pen.lineTo(box.right, height);
    pen.stroke();
    pen.setLineDash([]);
  }

  line(pen, curve, x, y) {
    pen.strokeStyle = this.colour(curve.colour);
    // Two wires of a pair read the same: the second is a thin line upon a wide one.
    pen.lineWidth = curve.paired && curve.kind === "measured" ? 7 : 1.6;
    pen.globalAlpha = curve.paired && curve.kind === "measured" ? 0.45 : 1;
    pen.lineJoin = "round";
    pen.setLineDash(DASHES[curve.kind]);
    pen.beginPath();
    let last = -Infinity;
    for (const [time, value] of curve.points) {
      if (time - last > GAP) pen.moveTo(x(time), y(value));
      else pen.lineTo(x(time), y(value));
      last = time;
    }
    pen.stroke();
    pen.setLineDash([]);
    pen.globalAlpha = 1;
  }

  readOut(pen, box, x) {
    const time = this.now - (this.span * (box.right - this.pointer)) / (box.right - box.left);
    if (time < this.now - this.span || time > this.now) return;
    const rows = [`${(time - this.now).toFixed(1)} s`];
    for (const { points, label } of this.curves) {
      const near = nearest(points, time);
      if (near) rows.push(`${label}  ${near[1].toPrecision(4)} ${this.unit}`);
    }
    pen.strokeStyle = this.colour("--quiet");
    pen.beginPath();
    pen.moveTo(x(time), box.top);
    pen.lineTo(x(time), box.bottom);
    pen.stroke();
    const width = Math.max(...rows.map((row) => pen.measureText(row).width)) + 12;
    const left = x(time) + 8 + width > box.right ? x(time) - 8 - width : x(time) + 8;
    pen.fillStyle = this.colour("--card");
    pen.fillRect(left, box.top, width, 16 * rows.length + 6);
    pen.strokeRect(left, box.top, width, 16 * rows.length + 6);
    pen.fillStyle = this.colour("--text");
    pen.textAlign = "left";
    pen.textBaseline = "top";
    rows.forEach((row, k) => pen.fillText(row, left + 6, box.top + 5 + 16 * k));
  }
}

function nearest(points, time) {
  let [low, high] = [0, points.length - 1];
  if (high < 0) return null;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (points[middle][0] < time) low = middle;
    else high = middle;
  }
  const best = time - points[low][0] < points[high][0] - time ? points[low] : points[high];
  return Math.abs(best[0] - time) < GAP ? best : null;
}
