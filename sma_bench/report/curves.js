// Interactive figures over time, by uPlot: values under the pointer, zoom by dragging. Without this
// script, and in print, the page shows the picture instead.
"use strict";
document.querySelectorAll("figure.curves script").forEach((source, number) => {
  const figure = source.parentElement;
  const box = document.createElement("div");
  box.className = "view";
  figure.prepend(box);
  figure.classList.add("drawn");
  const plots = JSON.parse(source.textContent).map((curve) => new uPlot({
    title: curve.title,
    width: box.clientWidth || 600,
    height: 190,
    cursor: { sync: { key: `figure ${number}`, scales: ["x", null] }, drag: { x: true, y: false } },
    scales: { x: { time: false } },
    axes: [{ label: curve.x_label, size: 34, labelSize: 16 }, { size: 62 }],
    series: [
      { label: "at", value: (_, v) => (v === null ? "" : short(v)) },
      ...curve.lines.map((line) => ({
        label: line.label,
        stroke: line.colour + (line.wide ? "80" : ""),
        width: line.wide ? 4 : 1.4,
        dash: line.dash,
        points: { show: false },
        value: (_, v) => (v === null || v === undefined ? "" : short(v)),
      })),
    ],
    hooks: { drawClear: [(plot) => background(plot, curve)] },
  }, uPlot.join(curve.lines.map((line) => [line.x, line.y])), box));
  new ResizeObserver(() => {
    if (box.clientWidth) plots.forEach((p) => p.setSize({ width: box.clientWidth, height: 190 }));
  }).observe(box);
});

function short(value) {
  return String(Number(value.toPrecision(4)));
}

// Draws the noise bands and the steps of the protocol.
function background(plot, { bands, marks }) {
  const { ctx, bbox } = plot;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.fillStyle = "#8884";
  for (const [low, high] of bands) {
    const [from, to] = [high, low].map((value) => plot.valToPos(value, "y", true));
    ctx.fillRect(bbox.left, from, bbox.width, to - from);
  }
  ctx.strokeStyle = "#888";
  ctx.setLineDash([2, 3]);
  for (const mark of marks) {
    const x = plot.valToPos(mark, "x", true);
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
  }
  ctx.restore();
}
