// Keeps the page alive: updates in, the stop out, and never an old number shown as a live one.

import { Plot } from "./plot.js";
import { element, inOrder, showDiagnosis, showIdentification, showWork, showAgain, showMeters, showNodes, showPlug, showProtocol, showStop } from "./panels.js";

const SILENT = 1.5; // s without an update or a reading
const RETRY = 1000; // ms
const STOP_PATIENCE = 8000; // ms
const COLOURS = 6;
const STROKES = { commanded: "dotted", model: "dashed" };
const LEADS = { measured: 0, commanded: 1, model: 2 };
const NO_ANSWER =
  "NOT CONFIRMED: the dashboard does not answer. Use the emergency stop of the bench.";

const quantities = JSON.parse(document.body.dataset.quantities);
const byId = (id) => document.getElementById(id);
const clock = () => performance.now() / 1000;
let page = null; // what this connection has brought
let lastUpdate = null; // s of clock(), of any connection
let socket = null;
let failure = ""; // why the page does not show the newest update, whole

// --- connection ---------------------------------------------------------------------------------

function connect() {
  const address = new URL("live", location.href);
  address.protocol = address.protocol.replace("http", "ws");
  socket = new WebSocket(address);
  page = { panels: {}, points: new Map(), signals: [], now: 0, due: 0, opened: clock() };
  socket.onmessage = (event) => whole(() => take(JSON.parse(event.data)));
  socket.onclose = () => setTimeout(connect, RETRY);
}

// What was not done to its end may have left old numbers anywhere on the page.
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
    const first = kept.findIndex(([time]) => time > update.now - update.span);
    signal.points = first < 0 ? [] : kept.slice(first);
    page.points.set(key, signal.points);
  }
  // A slow computer skips pictures, not updates.
  if (!page.due) page.due = requestAnimationFrame(() => whole(show));
}

function watch() {
  const silence = lastUpdate === null ? 0 : clock() - lastUpdate;
  const open = socket !== null && socket.readyState === WebSocket.OPEN;
  const cut = lastUpdate !== null && (silence > SILENT || (!open && silence > 0.3));
  const lost = cut || failure !== "";
  document.body.className = lost ? "lost" : lastUpdate === null ? "waiting" : "live";
  if (lost) {
    byId("connection").textContent = cut ?
      `CONNECTION LOST ${silence.toFixed(0)} s ago: what is below is old` :
      `LOST: this page cannot show what the bench sends (${failure}); what is below is old`;
    // Old numbers are not shown at all: a screen across the room has no grey.
    for (const old of document.querySelectorAll(".value")) old.textContent = "\u2013";
    for (const old of document.querySelectorAll("#meters .fill")) old.style.width = 0;
    byId("protocol-text").textContent = cut ? "unknown: connection lost" : "unknown";
    byId("protocol-bar").hidden = true;
    for (const state of document.querySelectorAll("#node-rows td:last-child")) {
      Object.assign(state, { textContent: "unknown", className: "" });
    }
    for (const button of document.querySelectorAll("#work-form button")) button.disabled = true;
    const stopped = byId("stop-result");
    if (stopped.className === "ok") {
      stopped.className = "old";
      stopped.prepend(element("p", "Of before the connection was lost:"));
    }
  } else if (lastUpdate !== null) {
    tellAge();
  }
}

function tellAge() {
  const measured = page.signals.filter((signal) => signal.kind === "measured");
  const silent = measured.filter((signal) => page.now - signal.heard > SILENT);
  const names = silent.map((signal) => `${signal.place} ${signal.quantity}`);
  byId("connection").textContent =
    !measured.length ? "connected, no readings from the bench" :
    names.length > 4 || names.length === measured.length ? `connected, ${names.length} of ${measured.length} signals are silent` :
    names.length ? `connected, silent: ${names.join(", ")}` : "live";
  if (!measured.length || names.length) document.body.className = "waiting";
}

// --- what is shown ------------------------------------------------------------------------------

const colour = (name) => getComputedStyle(document.body).getPropertyValue(name);
const plots = new Map();

function show() {
  page.due = 0;
  showProtocol(page.panels, page.now);
  showMeters(page.signals, page.panels, page.now);
  showNodes(page.panels, page.now);
  showPlug(page.panels);
  showDiagnosis(page.panels);
  showIdentification(page.panels);
  showWork(page.panels);
  showAgain(page.panels);
  byId("no-signals").hidden = page.signals.length > 0;
  for (const quantity of Object.keys(quantities)) {
    const signals = page.signals.filter((signal) => signal.quantity === quantity);
    if (signals.length) showPlot(quantity, signals);
  }
  failure = "";
}

function showPlot(quantity, signals) {
  const { title, unit } = quantities[quantity];
  if (!plots.has(quantity)) plots.set(quantity, addPlot(quantity, title, unit));
  const { plot, note, legend } = plots.get(quantity);
  const places = inLife(signals.map((signal) => signal.place));
  const colours = new Map(places.map((place) => [place, colourOf(place)]));
  const byPlace = signals.toSorted((a, b) => places.indexOf(a.place) - places.indexOf(b.place));
  const curves = byPlace.map((signal) => ({
    ...signal, colour: `--c${colours.get(signal.place)}`, paired: isFirst(signal.place),
    label: signal.kind === "measured" ? signal.place : `${signal.place} ${signal.kind}`,
  }));
  const limits = (page.panels.limits || { values: {} }).values;
  plot.show(curves, page.now, page.span, limits[quantity]);
  const kinds = new Set(signals.map((signal) => signal.kind));
  const limit = limits[quantity] === undefined ? [] : [`limit ${limits[quantity]} ${unit}`];
  note.textContent = [...kinds].filter((kind) => kind in STROKES)
    .map((kind) => `${STROKES[kind]}: ${kind}`).concat(limit).join(", ");
  legend.replaceChildren(...places.map((place) =>
    entry(place, signals.filter((signal) => signal.place === place), colours.get(place), unit)));
}

// A wire has one place in every list and one colour in all plots, as long as the page is open:
// whatever comes, goes or is asked anew. The bench's own order is waited for.
const life = [];
const CHANNELS_LATE = 3; // s

function inLife(places) {
  const known = page.panels.channels;
  if (known || clock() - page.opened > CHANNELS_LATE) {
    const all = [...(known || []), ...inOrder(places, page.panels)];
    for (const place of all) if (!life.includes(place)) life.push(place);
  }
  const rank = (place) => (life.includes(place) ? life.indexOf(place) : life.length);
  return inOrder(places, page.panels).sort((a, b) => rank(a) - rank(b));
}

function colourOf(place) {
  const wires = life.filter((name) => name !== "ambient");
  return place === "ambient" ? COLOURS - 1 : Math.max(wires.indexOf(place), 0) % (COLOURS - 1);
}

// Of wires that are numbered alike, front_1 and front_2, which mostly read the same.
const pairOf = (place) => life.filter((name) =>
  /\d$/.test(place) && name.replace(/\d+$/, "") === place.replace(/\d+$/, ""));
const isFirst = (place) => pairOf(place).length > 1 && pairOf(place)[0] === place;
const isSecond = (place) => pairOf(place).length > 1 && pairOf(place)[0] !== place;

function entry(place, signals, index, unit) {
  const made = element("span");
  made.append(element("span", "", `swatch k${index}${isSecond(place) ? " second" : isFirst(place) ? " first" : ""}`), `${place} `);
  for (const { kind, latest, heard } of signals.toSorted((a, b) => LEADS[a.kind] - LEADS[b.kind])) {
    const silent = page.now - heard > SILENT;
    const text = silent ? `silent ${(page.now - heard).toFixed(0)} s` :
      latest === null ? "none" : `${latest.toFixed(unit === "\u00b0C" ? 1 : 2)} ${unit}`;
    if (kind !== "measured") made.append(` ${kind} `);
    made.append(element("span", text, silent ? "value silent" : "value"));
  }
  return made;
}

function addPlot(quantity, title, unit) {
  const box = element("div", "", "plot");
  const canvas = element("canvas");
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${title} over the last minute; the values are below`);
  const legend = element("div", "", "legend");
  box.dataset.quantity = quantity;
  const head = element("h3", `${title} [${unit}] `);
  const note = element("small");
  head.append(note);
  box.append(head, canvas, legend);
  const order = Object.keys(quantities);
  const next = [...document.querySelectorAll(".plot")].find(
    (other) => order.indexOf(other.dataset.quantity) > order.indexOf(quantity));
  byId("plots").insertBefore(box, next || null);
  return { plot: new Plot(canvas, unit, colour), note, legend };
}

// --- the stop -----------------------------------------------------------------------------------

let stops = 0;

async function stop() {
  const button = byId("stop");
  const mine = ++stops;
  button.setAttribute("aria-busy", "true");
  showStop({ stopped: false, said: "Stop sent, waiting for the bench \u2026" });
  let result;
  try {
    const answer = await fetch("stop", { method: "POST", signal: AbortSignal.timeout(STOP_PATIENCE) });
    result = answer.ok ? await answer.json() : { stopped: false, said: NO_ANSWER };
  } catch {
    result = { stopped: false, said: NO_ANSWER };
  }
  if (mine !== stops) return; // a later press will answer
  button.removeAttribute("aria-busy");
  showStop(result);
}

byId("work-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const kind = event.submitter.value;
  const records = byId("records").value || byId("records").placeholder;
  const said = byId("work-said");
  said.textContent = `${kind}: asked \u2026`;
  let text;
  try {
    const answer = await fetch("work", { method: "POST", body: JSON.stringify({ kind, records }),
      signal: AbortSignal.timeout(STOP_PATIENCE) });
    text = answer.ok ? (await answer.json()).said : await answer.text();
  } catch {
    text = "the dashboard does not answer";
  }
  said.textContent = `${kind}: ${text}`;
});
byId("stop-form").addEventListener("submit", (event) => {
  event.preventDefault();
  stop();
});
document.addEventListener("keydown", (event) => {
  if (event.key !== "Escape" || event.repeat) return;
  event.preventDefault();
  stop();
});
window.addEventListener("resize", () => plots.forEach(({ plot }) => plot.draw()));

window.addEventListener("error", (event) => fail(event.message));
window.addEventListener("unhandledrejection", (event) => fail(String(event.reason)));

connect();
setInterval(watch, 250);
