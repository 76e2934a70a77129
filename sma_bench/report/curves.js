// Figures over time: values under the pointer, and a closer look by dragging. Without this script,
// and on paper, the picture stands there instead.
"use strict";
for (const source of document.querySelectorAll("figure.curves script")) {
  const curves = JSON.parse(source.textContent);
  const figure = source.parentElement;
  const all = [
    Math.min(...curves.flatMap((c) => c.lines.map((l) => l.x[0]))),
    Math.max(...curves.flatMap((c) => c.lines.map((l) => l.x[l.x.length - 1]))),
  ];
  const view = { from: all[0], to: all[1], at: null, dragged: null };
  const box = make("div", "view");
  const panels = curves.map(panel);
  const HINT = "Point for values, drag for a closer look, double click for all.";
  const hint = make("p", "hint", HINT);
  box.append(hint);
  figure.prepend(box);
  figure.classList.add("drawn");
  new ResizeObserver(draw).observe(box);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);

  function make(tag, className, text = "") {
    const made = document.createElement(tag);
    made.className = className;
    made.textContent = text;
    return made;
  }

  function panel(curve) {
    const legend = make("div", "legend");
    legend.append(make("strong", "", curve.title));
    const values = curve.lines.map((line) => {
      const entry = make("span", "entry");
      const swatch = make("canvas", "swatch");
      const value = make("span", "value");
      entry.append(swatch, line.label, value);
      legend.append(entry);
      return { swatch, value };
    });
    if (curve.bands.length) legend.append(make("span", "band", "noise"));
    const canvas = make("canvas", "");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", curve.title);
    box.append(legend, canvas);
    canvas.addEventListener("pointermove", (event) => {
      view.at = timeAt(canvas, event.offsetX);
      draw();
    });
    canvas.addEventListener("pointerdown", (event) => {
      // A finger scrolls the page and points; only a mouse drags.
      if (event.pointerType === "mouse") view.dragged = timeAt(canvas, event.offsetX);
    });
    canvas.addEventListener("pointerup", () => {
      const [from, to] = [view.dragged, view.at].sort((a, b) => a - b);
      if (view.dragged !== null && to - from > 0.01 * (view.to - view.from)) {
        Object.assign(view, { from: Math.max(from, all[0]), to: Math.min(to, all[1]) });
      }
      view.dragged = null;
      draw();
    });
    canvas.addEventListener("pointerleave", () => {
      view.at = view.dragged = null;
      draw();
    });
    canvas.addEventListener("dblclick", () => {
      [view.from, view.to] = all;
      draw();
    });
    return { curve, canvas, values };
  }

  function edges(canvas) {
    return { left: 52, right: canvas.clientWidth - 8, top: 6, bottom: canvas.clientHeight - 20 };
  }

  function timeAt(canvas, x) {
    const { left, right } = edges(canvas);
    return view.from + ((x - left) / (right - left)) * (view.to - view.from);
  }

  function draw() {
    const style = getComputedStyle(document.body);
    hint.textContent = view.at === null ? HINT : `At ${short(view.at)} s.`;
    panels.forEach((one, k) => drawPanel(one, style, k === panels.length - 1));
  }

  function drawPanel({ curve, canvas, values }, style, last) {
    const { clientWidth: width, clientHeight: height } = canvas;
    if (!width) return;
    const ratio = window.devicePixelRatio || 1;
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.font = "12px system-ui, sans-serif";
    const edge = edges(canvas);
    const [low, high] = range(curve);
    const x = (t) => edge.left + ((t - view.from) / (view.to - view.from)) * (edge.right - edge.left);
    const y = (v) => edge.bottom - ((v - low) / (high - low)) * (edge.bottom - edge.top);
    pen.strokeStyle = "#8884";
    pen.fillStyle = style.color;
    pen.textBaseline = "middle";
    pen.textAlign = "right";
    for (const v of ticks(low, high, 6)) {
      rule(pen, edge.left, y(v), edge.right, y(v));
      pen.fillText(short(v), edge.left - 5, y(v));
    }
    pen.textBaseline = "top";
    pen.textAlign = "center";
    for (const t of ticks(view.from, view.to, Math.max(2, Math.min(8, width / 90)))) {
      rule(pen, x(t), edge.top, x(t), edge.bottom);
      const unit = last && curve.x_label.includes("[s]") ? " s" : "";
      pen.fillText(short(t) + unit, Math.min(x(t), width - 18), edge.bottom + 5);
    }
    pen.save();
    pen.beginPath();
    pen.rect(edge.left, edge.top, edge.right - edge.left, edge.bottom - edge.top);
    pen.clip();
    pen.fillStyle = "#8884";
    for (const [from, to] of curve.bands) {
      pen.fillRect(edge.left, y(to), edge.right - edge.left, y(from) - y(to));
    }
    pen.setLineDash([2, 3]);
    pen.strokeStyle = "#888";
    for (const mark of curve.marks) rule(pen, x(mark), edge.top, x(mark), edge.bottom);
    pen.setLineDash([]);
    curve.lines.forEach((line, k) => {
      const colour = shade(line.colour);
      example(values[k].swatch, line, colour);
      values[k].value.textContent = view.at === null ? "" : valueAt(line);
      stroke(pen, line, colour, x, y);
    });
    curve.lines.forEach((line, k) =>
      marks(pen, line, shade(line.colour), k, curve.lines.length, x, y));
    if (view.dragged !== null && view.at !== null) {
      pen.fillStyle = "#8883";
      pen.fillRect(x(view.dragged), edge.top, x(view.at) - x(view.dragged), edge.bottom - edge.top);
    }
    pen.strokeStyle = style.color;
    if (view.at !== null) {
      rule(pen, x(view.at), edge.top, x(view.at), edge.bottom);
      const left = x(view.at) > (edge.left + edge.right) / 2;
      pen.fillStyle = style.color;
      pen.textAlign = left ? "right" : "left";
      pen.fillText(`${short(view.at)} s`, x(view.at) + (left ? -5 : 5), edge.top + 2);
    }
    pen.restore();
  }

  function rule(pen, x0, y0, x1, y1) {
    pen.beginPath();
    pen.moveTo(x0, y0);
    pen.lineTo(x1, y1);
    pen.stroke();
  }

  function stroke(pen, line, colour, x, y) {
    pen.strokeStyle = colour;
    pen.lineWidth = line.wide ? 4.5 : 1.4;
    pen.globalAlpha = line.wide ? 0.5 : 1;
    pen.setLineDash(line.dash);
    pen.beginPath();
    let gap = true;
    for (let k = 0; k < line.x.length; k++) {
      if (line.y[k] === null) gap = true;
      else {
        if (gap) pen.moveTo(x(line.x[k]), y(line.y[k]));
        else pen.lineTo(x(line.x[k]), y(line.y[k]));
        gap = false;
      }
    }
    pen.stroke();
    pen.setLineDash([]);
    pen.globalAlpha = 1;
  }

  // Marks tell lines apart where colours do not: those of different lines lie beside each other.
  const MARKS = 6;
  function marks(pen, line, colour, place, lines, x, y) {
    if (!line.mark) return;
    for (let k = 0; k < MARKS; k++) {
      const t = view.from + ((k + (place + 0.5) / lines) / MARKS) * (view.to - view.from);
      const v = line.y[nearest(line, t)];
      if (v !== null) mark(pen, line.mark, colour, x(t), y(v));
    }
  }

  function mark(pen, shape, colour, x, y) {
    const corners = { "^": [3, -0.5], v: [3, 0.5], s: [4, 0.25], D: [4, 0] }[shape];
    pen.beginPath();
    if (!corners) pen.arc(x, y, 3.5, 0, 2 * Math.PI);
    else {
      const [count, turn] = corners;
      for (let k = 0; k < count; k++) {
        const angle = Math.PI * (turn + (2 * k) / count);
        pen.lineTo(x + 4.5 * Math.cos(angle), y + 4.5 * Math.sin(angle));
      }
      pen.closePath();
    }
    pen.fillStyle = getComputedStyle(document.body).backgroundColor;
    pen.fill();
    pen.lineWidth = 1.3;
    pen.strokeStyle = colour;
    pen.stroke();
  }

  function example(swatch, line, colour) {
    [swatch.width, swatch.height] = [68, 20];
    const pen = swatch.getContext("2d");
    pen.scale(2, 2);
    stroke(pen, { ...line, x: [0, 34], y: [5, 5] }, colour, (t) => t, (v) => v);
    if (line.mark) mark(pen, line.mark, colour, 17, 5);
  }

  function nearest(line, t) {
    let k = line.x.findIndex((at) => at >= t);
    if (k < 0) k = line.x.length - 1;
    return k > 0 && t - line.x[k - 1] < line.x[k] - t ? k - 1 : k;
  }

  function valueAt(line) {
    const value = line.y[nearest(line, view.at)];
    return value === null ? "none" : short(value);
  }

  function range({ lines, bands }) {
    let [low, high] = [Infinity, -Infinity];
    for (const [from, to] of bands) [low, high] = [Math.min(low, from), Math.max(high, to)];
    for (const line of lines) {
      line.y.forEach((v, k) => {
        if (v === null || line.x[k] < view.from || line.x[k] > view.to) return;
        low = Math.min(low, v);
        high = Math.max(high, v);
      });
    }
    if (low > high) [low, high] = [0, 1];
    const room = 0.05 * (high - low) || Math.abs(high) * 0.05 || 1;
    return [low - room, high + room];
  }

  function ticks(low, high, most) {
    const power = 10 ** Math.floor(Math.log10((high - low) / most));
    const step = [1, 2, 5, 10].map((k) => k * power).find((s) => (high - low) / s <= most);
    const found = [];
    for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
    return found;
  }

  function short(value) {
    return String(Number(value.toPrecision(4)));
  }

  // The colours are made for white paper: on a dark page the same hues, lighter.
  function shade(colour) {
    if (!matchMedia("(prefers-color-scheme: dark)").matches) return colour;
    const [r, g, b] = [1, 3, 5].map((k) => parseInt(colour.slice(k, k + 2), 16) / 255);
    const most = Math.max(r, g, b);
    const spread = most - Math.min(r, g, b);
    if (!spread) return "hsl(0 0% 72%)";
    const sector = most === r ? (g - b) / spread : most === g ? 2 + (b - r) / spread : 4 + (r - g) / spread;
    const light = Math.round(86 - 20 * (most + most - spread));
    return `hsl(${60 * sector} ${Math.round(100 * Math.min(1, 0.2 + spread))}% ${light}%)`;
  }
}
