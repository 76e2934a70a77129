// The page: shows updates, sends the stop, and never shows an old number as a live one. Text is
// inserted as text only, never as HTML.

const SILENT = 1.5, NODE_SILENT = 4, CHANNELS_LATE = 3; // s; diagnostics come once a second
const RETRY = 1000, STOP_PATIENCE = 8000; // ms
const COLOURS = 6;
const KINDS = { measured: [], commanded: [2, 3], model: [7, 4] }; // dashes, in the legend's order
const STROKES = { commanded: "dotted", model: "dashed" };
const NO_ANSWER =
  "NOT CONFIRMED: the dashboard does not answer. Use the emergency stop of the bench.";

const quantities = JSON.parse(document.body.dataset.quantities);
const get = (id) => document.getElementById(id);
const all = (selector) => [...document.querySelectorAll(selector)];
const clock = () => performance.now() / 1000;
let page = null; // the data of this connection
let lastUpdate = null; // s of clock(), of any connection
let socket = null;
let failure = ""; // why the page does not show all of the newest update

function element(tag, text = "", className = "", ...children) {
  const made = document.createElement(tag);
  made.textContent = text;
  made.className = className;
  made.append(...children);
  return made;
}

// --- connection ---------------------------------------------------------------------------------

function connect() {
  const address = new URL("live", location.href);
  address.protocol = address.protocol.replace("http", "ws");
  socket = new WebSocket(address);
  page = { panels: {}, points: new Map(), signals: [], now: 0, due: 0, opened: clock() };
  socket.onmessage = (event) => whole(() => take(JSON.parse(event.data)));
  socket.onclose = () => setTimeout(connect, RETRY);
}

// If `act` fails half-way, old numbers may be left anywhere on the page.
function whole(act) {
  try {
    act();
  } catch (error) {
    fail(String(error));
  }
}

function fail(why) {
  failure = why;
  watch();
}

function take(update) {
  lastUpdate = clock();
  Object.assign(page.panels, update.panels);
  Object.assign(page, { now: update.now, span: update.span, signals: update.signals });
  for (const signal of update.signals) {
    const key = `${signal.quantity}/${signal.place}/${signal.kind}`;
    const kept = (page.points.get(key) || []).concat(signal.points);
    signal.points = kept.filter(([time]) => time > update.now - update.span);
    page.points.set(key, signal.points);
  }
  // A slow computer skips drawings, not updates.
  if (!page.due) page.due = requestAnimationFrame(() => whole(show));
}

function watch() {
  const silence = lastUpdate === null ? 0 : clock() - lastUpdate;
  const open = socket !== null && socket.readyState === WebSocket.OPEN;
  const cut = lastUpdate !== null && (silence > SILENT || (!open && silence > 0.3));
  if (cut || failure !== "") return showLost(cut, silence);
  document.body.className = lastUpdate === null ? "waiting" : "live";
  if (lastUpdate === null) return;
  const measured = page.signals.filter((signal) => signal.kind === "measured");
  const names = measured.filter((signal) => page.now - signal.heard > SILENT)
    .map((signal) => `${signal.place} ${signal.quantity}`);
  const most = names.length > 4 || names.length === measured.length;
  get("connection").textContent =
    !measured.length ? "connected, no readings from the bench" :
    !names.length ? "live" :
    most ? `connected, ${names.length} of ${measured.length} signals are silent` :
    `connected, silent: ${names.join(", ")}`;
  if (!measured.length || names.length) document.body.className = "waiting";
}

// Old numbers are hidden, not greyed: grey cannot be seen from across the room.
function showLost(cut, silence) {
  document.body.className = "lost";
  get("connection").textContent = cut ?
    `CONNECTION LOST ${silence.toFixed(0)} s ago: all below is old` :
    `LOST: this page cannot show what the bench sends (${failure}); all below is old`;
  for (const old of all(".value")) old.textContent = "\u2013";
  for (const old of all("#meters .fill")) old.style.width = 0;
  get("protocol-text").textContent = cut ? "unknown: connection lost" : "unknown";
  get("protocol-bar").hidden = true;
  for (const state of all("#node-rows td:last-child")) {
    Object.assign(state, { textContent: "unknown", className: "" });
  }
  for (const button of all("#work-form button")) button.disabled = true;
  const stopped = get("stop-result");
  if (stopped.className !== "ok") return;
  stopped.className = "old";
  stopped.prepend(element("p", "From before the connection was lost:"));
}

function show() {
  const { panels, now, signals } = page;
  page.due = 0;
  showProtocol(panels, now);
  showMeters(signals, panels, now);
  showNodes(panels, now);
  showPlug(panels);
  showResult("diagnosis", panels.diagnosis);
  showResult("identification", panels.identification);
  showWork(panels);
  showAgain(panels);
  get("no-signals").hidden = signals.length > 0;
  for (const quantity of Object.keys(quantities)) {
    const found = signals.filter((signal) => signal.quantity === quantity);
    if (found.length) showPlot(quantity, found);
  }
  failure = "";
}

// --- beside the plots ---------------------------------------------------------------------------

function showProtocol(panels, now) {
  const progress = panels.progress;
  if (!progress) return;
  const { node, protocol, step, duration, elapsed, heard } = progress;
  const state = (panels.states || {})[node] || "";
  const there = (panels.there || []).includes(node);
  const running = state.startsWith("running") && there;
  const late = running && now - heard > SILENT;
  const whole = duration ? ` of ${duration.toFixed(0)} s` : " s";
  let text = running ? `${protocol}, ${step}: ${elapsed.toFixed(1)}${whole}` : state;
  if (late) text += ` \u2013 silent for ${(now - heard).toFixed(0)} s`;
  if (!there) text = `${node} is gone (last: ${state})`;
  get("protocol-text").textContent = text;
  get("protocol-text").className = late || !there || state.startsWith("aborted") ? "silent" : "";
  get("protocol-bar").hidden = !duration || !running;
  if (duration) get("protocol-bar").value = Math.min(1, elapsed / duration);
}

function meter(name, share, text, className = "", silent = false) {
  const fill = element("div", "", "fill");
  fill.style.width = `${100 * Math.max(0, Math.min(1, share))}%`;
  return element("div", "", `meter ${className}`, element("span", name),
    element("div", "", "track", fill), element("span", text, silent ? "value silent" : "value"));
}

function showMeters(signals, panels, now) {
  const { values, of } = panels.limits || { values: {}, of: [] };
  const limit = values.temperature;
  get("heat-limit").textContent = limit === undefined ? "no node tells its limit" :
    `limit ${limit.toFixed(1)} \u00b0C, of ${of.join(", ")}`;
  const wires = new Map(signals.filter((signal) => signal.quantity === "temperature" &&
    signal.kind === "measured" && signal.place !== "ambient").map((wire) => [wire.place, wire]));
  if (!wires.size) return;
  get("meters").replaceChildren(...inOrder([...wires.keys()], panels).map((place) => {
    const { latest, heard } = wires.get(place);
    if (now - heard > SILENT || latest === null) {
      return meter(place, 0, `silent ${(now - heard).toFixed(0)} s`, "", true);
    }
    const over = limit && latest > limit, near = limit && latest > 0.9 * limit;
    return meter(place, limit ? latest / limit : 0,
      `${latest.toFixed(1)} \u00b0C${over ? " over" : ""}`, over ? "over" : near ? "near" : "");
  }));
}

function showNodes(panels, now) {
  const rows = Object.entries(panels.states || {}).map(([node, state]) => {
    const gone = !(panels.there || []).includes(node);
    const bad = gone || /^(stopped|still flowing|aborted|not connected|failed)/.test(state);
    return [node, gone ? `gone (last: ${state})` : state, bad ? "error" : ""];
  });
  for (const [name, { level, message, heard }] of Object.entries(panels.diagnostics || {})) {
    const silent = now - heard > NODE_SILENT;
    rows.push(silent ? [name, `silent for ${(now - heard).toFixed(0)} s`, "error"] :
      [name, message || level, level]);
  }
  rows.sort((a, b) => a[0].localeCompare(b[0]));
  get("node-rows").replaceChildren(...rows.map(([name, text, level]) =>
    element("tr", "", "", element("td", name), element("td", text, level))));
  const stops = panels.stops || [], elsewhere = panels.elsewhere || [];
  get("stops").textContent = (stops.length ?
    `STOP calls the stop services of ${stops.join(", ")} and commands 0 V.` :
    "STOP commands 0 V: no node here has a stop service.") +
    (elsewhere.length ? ` Other benches: ${elsewhere.join(", ")} (--namespace).` : "");
}

// No button can switch this current off: shown largest, above the stop, until the node's state ends.
function showPlug(panels) {
  const flowing = Object.entries(panels.states || {})
    .filter(([, state]) => state.startsWith("still flowing"));
  const said = JSON.stringify(flowing);
  if (get("plug").dataset.said !== said) {
    get("plug").dataset.said = said;
    get("plug").replaceChildren(element("strong", "PULL THE PLUG"),
      ...flowing.map(([node, state]) => element("p", `${node}: ${state}`)));
  }
  get("plug").hidden = !flowing.length;
  document.title = (flowing.length ? "PULL THE PLUG - " : "") +
    document.title.replace(/^PULL THE PLUG - /, "");
}

// Lines may break inside a name at dots and underscores, but not inside numbers and options.
const broken = (name) => element("td", "", "", ...name.split(/(?<=[._])/)
  .flatMap((part) => [part, document.createElement("wbr")]));
const unbroken = (tag, text, className = "") => element(tag, "", className,
  ...text.split(/(--[a-z][\w-]*|[\d.]+e-\d+)/)
    .map((part, k) => (k % 2 ? element("span", part, "keep") : part)));

function showResult(name, found) {
  if (!found) return;
  get(`${name}-content`).replaceChildren(...(found.problem ?
    [element("p", found.problem, "error")] :
    [element("p", "", "", element("strong", found.title)),
      element("table", "", "numbers", ...found.rows.map(([row, number]) =>
        element("tr", "", "", broken(row), unbroken("td", number)))),
      ...found.lines.map((line) => unbroken("p", line, "quiet"))]));
}

function showWork(panels) {
  const works = panels.works || [];
  get("work").hidden = !works.length;
  for (const button of all("#work-form button")) {
    button.hidden = !works.includes(button.value);
    button.disabled = false;
  }
  if (panels.recorded) get("records").placeholder = panels.recorded;
  if (!panels.work) return;
  get("work-said").textContent = panels.work.text;
  get("work-said").className = panels.work.good ? "" : "bad";
}

// --- plots --------------------------------------------------------------------------------------

const colour = (name) => () => getComputedStyle(document.body).getPropertyValue(name);
const plots = new Map();

// Places without duplicates: channels in the bench's order, then the others by name.
function inOrder(places, panels) {
  const channels = panels.channels || [];
  const rank = (place) => (channels.includes(place) ? channels.indexOf(place) : channels.length);
  return [...new Set(places)].sort((a, b) => rank(a) - rank(b) || a.localeCompare(b));
}

// A wire keeps its position in every list and its colour in all plots as long as the page is open,
// even after reconnecting. Positions are given once the bench's own order is known, or is late.
const life = [];

function inLife(places) {
  const known = page.panels.channels;
  if (known || clock() - page.opened > CHANNELS_LATE) {
    for (const place of [...(known || []), ...inOrder(places, page.panels)]) {
      if (!life.includes(place)) life.push(place);
    }
  }
  const rank = (place) => (life.includes(place) ? life.indexOf(place) : life.length);
  return inOrder(places, page.panels).sort((a, b) => rank(a) - rank(b));
}

// A wire's colour, and its role in a group of numbered wires (front_1, front_2), which mostly read
// the same: the first is a wide line, the others thin ones on top of it.
function look(place) {
  const wires = life.filter((name) => name !== "ambient");
  const index = place === "ambient" ? COLOURS - 1 :
    Math.max(wires.indexOf(place), 0) % (COLOURS - 1);
  const pair = life.filter((name) => /\d$/.test(place) &&
    name.replace(/\d+$/, "") === place.replace(/\d+$/, ""));
  return { index, pair: pair.length < 2 ? "" : pair[0] === place ? " first" : " second" };
}

function showPlot(quantity, signals) {
  const { unit } = quantities[quantity];
  if (!plots.has(quantity)) plots.set(quantity, addPlot(quantity));
  const shown = plots.get(quantity);
  const places = inLife(signals.map((signal) => signal.place));
  const order = Object.keys(KINDS);
  const curves = signals.toSorted((a, b) => places.indexOf(a.place) - places.indexOf(b.place) ||
    order.indexOf(a.kind) - order.indexOf(b.kind));
  const limit = ((page.panels.limits || {}).values || {})[quantity];
  draw(shown, curves, unit, limit);
  const notes = order.filter((kind) => kind in STROKES && curves.some((c) => c.kind === kind))
    .map((kind) => `${STROKES[kind]}: ${kind}`);
  shown.note.textContent =
    notes.concat(limit === undefined ? [] : [`limit ${limit} ${unit}`]).join(", ");
  shown.legend.replaceChildren(...places.map((place) => {
    const { index, pair } = look(place);
    const made = element("span", "", "", element("span", "", `swatch k${index}${pair}`),
      `${place} `);
    for (const { kind, latest, heard } of curves.filter((curve) => curve.place === place)) {
      const silent = page.now - heard > SILENT;
      const text = silent ? `silent ${(page.now - heard).toFixed(0)} s` :
        latest === null ? "none" : `${latest.toFixed(unit === "\u00b0C" ? 1 : 2)} ${unit}`;
      if (kind !== "measured") made.append(` ${kind} `);
      made.append(element("span", text, silent ? "value silent" : "value"));
    }
    return made;
  }));
}

function addPlot(quantity) {
  const { title, unit } = quantities[quantity];
  const note = element("small"), legend = element("div", "", "legend");
  const canvas = element("div", "", "canvas"), tip = element("div", "", "tip");
  tip.hidden = true;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${title} over the last minute; the values are below`);
  const box = element("div", "", "plot", element("h3", `${title} [${unit}] `, "", note), canvas,
    tip, legend);
  box.dataset.quantity = quantity;
  const order = Object.keys(quantities);
  const next = all(".plot").find(
    (other) => order.indexOf(other.dataset.quantity) > order.indexOf(quantity));
  get("plots").insertBefore(box, next || null);
  const shown = { note, legend, canvas, tip, of: "" };
  new ResizeObserver(() => shown.plot && shown.plot.setSize(sizeOf(canvas))).observe(canvas);
  return shown;
}

const sizeOf = (box) => ({ width: box.clientWidth, height: box.clientHeight });

function draw(shown, curves, unit, limit) {
  Object.assign(shown, { now: page.now, limit });
  // A pause longer than SILENT is a gap; times at which only other curves have readings are not.
  const data = uPlot.join(curves.map(({ points }) => {
    const broken = points.flatMap(([time, value], k) => (
      k && time - points[k - 1][0] > SILENT ? [[time - 1e-3, null], [time, value]] :
      [[time, value]]));
    return [broken.map(([time]) => time), broken.map(([, value]) => value)];
  }));
  const of = JSON.stringify(curves.map(({ place, kind }) => [place, kind, look(place)]));
  if (shown.of === of) return shown.plot.setData(data);
  if (shown.plot) shown.plot.destroy();
  const quiet = { stroke: colour("--quiet"), font: "12px system-ui, sans-serif" };
  const none = { show: false };
  shown.of = of;
  shown.plot = new uPlot({
    ...sizeOf(shown.canvas), legend: none, padding: [8, 16, 0, 0],
    cursor: { drag: { x: false, y: false }, y: false, points: none },
    scales: {
      x: { time: false, range: () => [shown.now - page.span, shown.now] },
      y: { range: (_, low, high) => room(low, high, shown.limit) },
    },
    axes: [
      { ...quiet, grid: none, ticks: none, size: 20, gap: 3,
        splits: () => [60, 45, 30, 15, 0].map((ago) => shown.now - ago),
        values: () => ["\u221260 s", "\u221245 s", "\u221230 s", "\u221215 s", "now"] },
      { ...quiet, grid: { stroke: colour("--line"), width: 1 }, ticks: none, size: 52 },
    ],
    series: [{}, ...curves.map(({ place, kind }) => {
      const wide = look(place).pair === " first" && kind === "measured";
      return { stroke: colour(`--c${look(place).index}`), dash: KINDS[kind], points: none,
        width: wide ? 7 : 1.6, alpha: wide ? 0.45 : 1,
        label: kind === "measured" ? place : `${place} ${kind}` };
    })],
    hooks: {
      draw: [(plot) => drawLimit(plot, shown.limit)],
      setCursor: [(plot) => showTip(plot, shown, unit)],
    },
  }, data, shown.canvas);
}

// A limit far above the signal would flatten it and is left out; the meters show it anyway.
function room(low, high, limit) {
  if (low === null) [low, high] = [0, 1];
  if (limit !== undefined && high > 0.6 * limit) high = Math.max(high, limit);
  const more = Math.max(0.06 * (high - low), 1e-3 * Math.max(Math.abs(high), Math.abs(low)), 1e-3);
  return [low - more, high + more];
}

function drawLimit(plot, limit) {
  if (limit === undefined || limit > plot.scales.y.max) return;
  const { ctx, bbox } = plot, height = plot.valToPos(limit, "y", true);
  ctx.save();
  Object.assign(ctx, { strokeStyle: colour("--bad")(), lineWidth: 1.5 * uPlot.pxRatio });
  ctx.setLineDash([8, 5]);
  ctx.beginPath();
  ctx.moveTo(bbox.left, height);
  ctx.lineTo(bbox.left + bbox.width, height);
  ctx.stroke();
  ctx.restore();
}

// The values at the pointer, of each curve the nearest.
function showTip(plot, { tip, now }, unit) {
  const { left, idx } = plot.cursor;
  tip.hidden = left < 0 || idx === null;
  if (tip.hidden) return;
  const time = plot.posToVal(left, "x"), times = plot.data[0];
  const rows = [`${(time - now).toFixed(1)} s`];
  for (const [k, { label }] of plot.series.entries()) {
    let best = SILENT, value = null;
    for (let i = 0; k && i < times.length; i++) {
      const off = Math.abs(times[i] - time);
      if (off < best && Number.isFinite(plot.data[k][i])) [best, value] = [off, plot.data[k][i]];
    }
    if (value !== null) rows.push(`${label}  ${value.toPrecision(4)} ${unit}`);
  }
  tip.replaceChildren(...rows.map((row) => element("div", row)));
  const right = left > plot.over.clientWidth / 2;
  tip.style.left = right ? "" : `${plot.over.offsetLeft + left + 8}px`;
  tip.style.right = right ? `${plot.over.clientWidth - left + 16}px` : "";
}

// --- the stop, and work on records --------------------------------------------------------------

let stops = 0;
let shownAgain = null;

async function stop() {
  const mine = ++stops;
  get("stop").setAttribute("aria-busy", "true");
  showStop({ stopped: false, said: "Stop sent, waiting for the bench \u2026" });
  const result = await posted("stop") || { stopped: false, said: NO_ANSWER };
  if (mine !== stops) return; // a later press will show its own answer
  get("stop").removeAttribute("aria-busy");
  showStop(typeof result === "string" ? { stopped: false, said: NO_ANSWER } : result);
}

// The answer; a text if the request is refused, null if there is no answer.
async function posted(where, body) {
  try {
    const answer = await fetch(where, { method: "POST", body: body && JSON.stringify(body),
      signal: AbortSignal.timeout(STOP_PATIENCE) });
    return await (answer.ok ? answer.json() : answer.text());
  } catch {
    return null;
  }
}

function showStop({ stopped, said, answers = [], voltages = {} }) {
  const volts = Object.entries(voltages).map(([wire, v]) => `${wire} ${v.toFixed(2)} V`);
  const time = new Date().toLocaleTimeString();
  get("stop-result").hidden = false;
  get("stop-result").className = stopped ? "ok" : "bad";
  get("stop-result").replaceChildren(element("p", said, "said"),
    ...(volts.length ? [element("p", `Read at ${time}: ${volts.join(", ")}`)] : []),
    element("ul", "", "", ...answers.map(({ node, success, message }) =>
      element("li", `${node}: ${success ? message : `FAILED: ${message}`}`))));
}

// After a confirmed stop: warn everybody who saw it that a voltage is on again.
function showAgain({ again }) {
  if (!again || again === shownAgain) return;
  shownAgain = again;
  const volts = again.volts === null ? "a voltage" : `${again.volts.toFixed(2)} V`;
  showStop({ stopped: false, said: `VOLTAGE IS ON AGAIN: ${again.place} ${volts}, ` +
    `${again.seconds.toFixed(1)} s after the stop.` });
}

get("work-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const kind = event.submitter.value;
  get("work-said").textContent = `${kind}: asked \u2026`;
  const records = get("records").value || get("records").placeholder;
  const answer = await posted("work", { kind, records }) || "the dashboard does not answer";
  get("work-said").textContent = `${kind}: ${answer.said || answer}`;
});
get("stop-form").addEventListener("submit", (event) => {
  event.preventDefault();
  stop();
});
document.addEventListener("keydown", (event) => {
  if (event.key !== "Escape" || event.repeat) return;
  event.preventDefault();
  stop();
});
window.addEventListener("error", (event) => fail(event.message));
window.addEventListener("unhandledrejection", (event) => fail(String(event.reason)));

connect();
setInterval(watch, 250);
